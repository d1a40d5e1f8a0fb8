// Edits the graph of a copy of the lab in the studio's page in Chromium and prints what it saw as JSON.
// node test/edit.mjs ADDRESS CHROMIUM FOLDER

import { chromium } from "playwright-core";

const [address, executablePath, folder] = process.argv.slice(2);
const FLOOR = [-6.4, -3, 4.6, 3.4]; // m, of the lab
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1100, height: 1000 } });
const seen = { errors: [] };
page.on("console", (message) => message.type() === "error" && seen.errors.push(message.text()));
page.on("pageerror", (error) => seen.errors.push(String(error)));
const differs = (part) =>
  page.waitForFunction((part) => document.querySelector("[data-studio]").dataset.difference.includes(part), part);
const tick = async () => Number(await page.locator("[data-studio]").getAttribute("data-tick"));

await page.goto(address);
await page.waitForSelector("[data-open=yes]");
await page.getByRole("button", { name: "edit graph" }).click();
await page.getByRole("button", { name: "play" }).click();
const box = await page.locator(".replay-plan").boundingBox();
const scale = 0.96 * Math.min(box.width / (FLOOR[2] - FLOOR[0]), box.height / (FLOOR[3] - FLOOR[1]));
const at = (x, y) => [
  box.x + box.width / 2 + (x - (FLOOR[0] + FLOOR[2]) / 2) * scale,
  box.y + box.height / 2 - (y - (FLOOR[1] + FLOOR[3]) / 2) * scale,
];
const drag = async (from, to) => {
  await page.mouse.move(...at(...from));
  await page.mouse.down();
  await page.mouse.move(...at((from[0] + to[0]) / 2, (from[1] + to[1]) / 2));
  await page.mouse.move(...at(...to));
  await page.mouse.up();
};
const [door, moved, corner] = [[-3.113, -0.837], [-2.5, -0.5], [-2.698, 1.844]];
await drag(door, moved);
await differs("+  door");
seen.before = await tick();
await page.mouse.click(...at((moved[0] + corner[0]) / 2, (moved[1] + corner[1]) / 2));
await differs("high");
await drag(moved, [-6.0, 2.9]);
await page.waitForFunction(() => document.querySelector(".studio-note").textContent.includes("obstacle"));
seen.note = await page.locator(".studio-note").textContent();
await page.mouse.click(...at(...moved));
await page.getByLabel("radius, m").fill("0.75");
await page.getByLabel("radius, m").press("Enter");
await differs("0.75");
await page.getByRole("button", { name: "undo" }).click();
await page.waitForFunction(() => !document.querySelector("[data-studio]").dataset.difference.includes("0.75"));
seen.after = await tick();
await page.screenshot({ path: `${folder}/edit.png` });
await page.getByRole("button", { name: "save" }).click();
await page.waitForFunction(() => !document.querySelector("[data-studio]").dataset.difference, null, { timeout: 60000 });
await browser.close();
console.log(JSON.stringify(seen));
