// Heights of a notebook's frame and of the page in it, in Chromium, as JSON.
// node test/frame.mjs PAGE CHROMIUM

import { chromium } from "playwright-core";
import { pathToFileURL } from "node:url";

const [file, executablePath] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1000, height: 700 } });
const heights = [];
await page.goto(String(pathToFileURL(file)));
const frame = page.frameLocator("iframe");
await frame.locator("[data-ready]").waitFor();
for (const width of [1000, 420]) {
  await page.setViewportSize({ width, height: 700 });
  await page.waitForTimeout(400);
  const inside = await frame.locator("html").evaluate((root) => root.scrollHeight);
  heights.push([await page.locator("iframe").evaluate((element) => element.clientHeight), inside]);
}
await browser.close();
console.log(JSON.stringify(heights));
