// Pictures of a replay page, one every SECONDS of the episode, for an animation such as README's.
// node film.mjs PAGE.html CHROMIUM FOLDER [SECONDS] [WIDTH]

import { mkdirSync } from "node:fs";
import { chromium } from "playwright-core";
import { pathToFileURL } from "node:url";

const [file, executablePath, folder, seconds = "0.5", width = "640"] = process.argv.slice(2);
mkdirSync(folder, { recursive: true });
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: Number(width), height: 1400 }, colorScheme: "light" });
await page.goto(`${pathToFileURL(file)}#t=0`);
await page.waitForSelector("[data-ready='0']");
await page.addStyleTag({ content: ".replay-bar { display: none !important; }" });
const duration = Number.parseFloat((await page.locator(".replay-clock").first().textContent()).split("of")[1]);
for (let index = 0; index * Number(seconds) <= duration; index++) {
  await page.evaluate((time) => { location.hash = `#t=${time}`; }, index * Number(seconds));
  await page.waitForTimeout(60);
  await page.locator(".replay").first().screenshot({ path: `${folder}/${String(index).padStart(4, "0")}.png` });
}
await browser.close();
