// Asks on a page of two replays where they part, and prints the answer and the clocks as JSON.
// node test/apart.mjs PAGE.html CHROMIUM

import { chromium } from "playwright-core";
import { pathToFileURL } from "node:url";

const [file, executablePath] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1100, height: 900 } });
await page.goto(String(pathToFileURL(file)));
await page.waitForFunction(() => document.querySelectorAll("[data-ready='0']").length === 2);
await page.getByLabel("time").first().evaluate((slider) => {
  slider.value = "3";
  slider.dispatchEvent(new Event("input"));
});
await page.getByRole("button", { name: "where they part" }).click();
const said = await page.locator(".replay-controls output:not(.replay-clock)").first().textContent();
await page.waitForTimeout(200);
const clocks = await page.locator(".replay-clock").allTextContents();
await browser.close();
console.log(JSON.stringify({ said, clocks }));
