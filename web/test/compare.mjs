// Plays a comparison in Chromium and prints what it saw as JSON.
// node test/compare.mjs PAGE CHROMIUM

import { chromium } from "playwright-core";
import { pathToFileURL } from "node:url";
import { drawn } from "./drawn.mjs";

const [file, executablePath, picture] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1400, height: 1000 } });
const seen = { errors: [] };
page.on("pageerror", (error) => seen.errors.push(String(error)));
const clocks = async () => (await page.locator(".replay-clock").allTextContents()).map(Number.parseFloat);
const first = page.locator(".replay").first();

await page.goto(String(pathToFileURL(file)));
await page.waitForFunction(() => document.querySelectorAll("[data-ready]").length === 2);
await first.getByLabel("play").click();
await page.waitForTimeout(800);
await page.locator(".replay").last().getByLabel("pause").click();
await drawn(page);
seen.played = await clocks();
await first.getByLabel("time").evaluate((slider) => {
  slider.value = "3";
  slider.dispatchEvent(new Event("input"));
});
await drawn(page);
seen.sought = await clocks();
await first.getByRole("button", { name: "where they part" }).click();
await drawn(page);
seen.parted = await clocks();
await first.getByLabel("episode", { exact: true }).selectOption("1");
await page.waitForFunction(() => document.querySelectorAll("[data-ready='1']").length === 2);
seen.opened = await clocks();
const visible = (where) => where.locator("[data-view]:visible").evaluateAll((views) => views.map((view) => view.dataset.view));
seen.views = [await visible(page)];
await page.getByLabel("Situation").selectOption("empty");
seen.views.push(await visible(page));
const narrow = await browser.newPage({ viewport: { width: 420, height: 900 }, javaScriptEnabled: false });
await narrow.goto(String(pathToFileURL(file)));
seen.plain = await visible(narrow);
seen.folded = await narrow.locator("details[data-view] > summary").allTextContents();
const column = await narrow.locator("[data-view=overall] th:nth-child(2)").first().boundingBox();
seen.right = column.x + column.width;
if (picture) await page.screenshot({ path: picture });
await browser.close();
console.log(JSON.stringify(seen));
