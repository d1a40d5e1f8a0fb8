// Drives in the studio's page in Chromium and prints what it saw as JSON.
// node test/studio.mjs ADDRESS CHROMIUM FOLDER

import { chromium } from "playwright-core";

const [address, executablePath, folder] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1100, height: 900 } });
const seen = { errors: [], hosts: [], outcomes: [], cards: [] };
page.on("console", (message) => message.type() === "error" && seen.errors.push(message.text()));
page.on("pageerror", (error) => seen.errors.push(String(error)));
page.on("request", (request) => request.url().startsWith("data:") || seen.hosts.push(new URL(request.url()).host));
page.on("websocket", (socket) => seen.hosts.push(new URL(socket.url()).host));
const studio = page.locator("[data-studio]");
const tick = async () => Number(await studio.getAttribute("data-tick"));
const speed = async () => Number(await studio.getAttribute("data-speed"));
const press = (name) => page.getByRole("button", { name, exact: true }).click();
const moving = () => page.waitForFunction(() => Number(document.querySelector("[data-studio]").dataset.speed) > 0.1);
const standing = () => page.waitForFunction(() => Number(document.querySelector("[data-studio]").dataset.speed) < 0.02);

await page.goto(address);
await page.waitForSelector("[data-open=yes]");
await page.getByLabel("view").selectOption("third_person");
for (const key of ["w", "ArrowUp"]) {
  await press("record");
  await press("drive");
  await page.waitForSelector("[data-human=yes]");
  await page.keyboard.down(key);
  await moving();
  await page.waitForTimeout(1000);
  await page.keyboard.up(key);
  await standing();
  seen.before = await tick();
  await page.getByLabel("time").evaluate((slider) => {
    slider.value = "0.5";
    slider.dispatchEvent(new Event("input"));
  });
  await press("drive from here");
  await page.waitForFunction((before) => Number(document.querySelector("[data-studio]").dataset.tick) < before, seen.before);
  seen.rewound = await tick();
  await page.evaluate(() => {
    const pad = { axes: [0, -0.9], buttons: Array.from({ length: 6 }, (_, k) => ({ pressed: k === 5 })) };
    navigator.getGamepads = () => [pad];
  });
  await moving();
  seen.gamepad = await speed();
  await page.evaluate(() => (navigator.getGamepads = () => []));
  await standing();
  await press("give back");
  await page.waitForSelector("[data-human=no]");
  await page.getByLabel("speed").selectOption("16");
  await page.waitForFunction(() => document.querySelector("[data-studio]").dataset.outcome !== "", null, { timeout: 120000 });
  seen.outcomes.push(await studio.getAttribute("data-outcome"));
  if (key === "w") {
    await page.waitForFunction(() => document.querySelectorAll(".studio-card thead th").length === 4, null, { timeout: 120000 });
    seen.cards = (await page.locator(".studio-card thead th").allTextContents()).slice(1);
    await page.waitForSelector("[data-picture]");
    seen.picture = await studio.getAttribute("data-picture");
    await page.screenshot({ path: `${folder}/studio.png` });
  }
  await page.getByLabel("speed").selectOption("1");
  await press("next episode");
  await page.waitForFunction(() => document.querySelector("[data-studio]").dataset.outcome === "");
}
await browser.close();
console.log(JSON.stringify(seen));
