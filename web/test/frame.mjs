// A replay page in the frame of a notebook, in Chromium: heights of frame and page, first moment, themes, as JSON.
// node test/frame.mjs PAGE CHROMIUM

import { chromium } from "playwright-core";
import { pathToFileURL } from "node:url";

const [file, executablePath] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1000, height: 700 }, colorScheme: "light" });
const seen = { heights: [], themes: [] };
await page.goto(String(pathToFileURL(file)));
const frame = page.frameLocator("iframe");
await frame.locator("[data-ready]").waitFor();
await page.waitForTimeout(200);
seen.opened = Number.parseFloat(await frame.locator(".replay-clock").textContent());
seen.paused = await frame.getByLabel("play", { exact: true }).count();
for (const width of [1000, 420]) {
  await page.setViewportSize({ width, height: 700 });
  await page.waitForTimeout(400);
  const inside = await frame.locator("body").evaluate((body) => body.getBoundingClientRect().height);
  seen.heights.push([await page.locator("iframe").evaluate((element) => element.clientHeight), inside]);
}
const hosts = [
  ["body", "data-jp-theme-light", "false"],
  ["body", "data-jp-theme-light", "true"],
  ["body", "data-md-color-scheme", "slate"],
  ["body", "data-md-color-scheme", "default"],
  ["body", "class", "vscode-dark"],
  ["body", "class", "vscode-light"],
  ["html", "theme", "dark"],
  ["html", "theme", "light"],
];
for (const [element, name, value] of hosts) {
  for (const colorScheme of ["light", "dark"]) {
    await page.emulateMedia({ colorScheme });
    const place = page.locator(element).first();
    await place.evaluate((node, [name, value]) => node.setAttribute(name, value), [name, value]);
    await page.waitForTimeout(150);
    const paper = await frame.locator(".replay").evaluate((node) => getComputedStyle(node).backgroundColor);
    const floor = await frame.locator(".replay-plan").evaluate((canvas) => {
      const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
      return pixels.filter((_, k) => k % 4 === 0).sort()[pixels.length / 8]; // the middle red, that of the floor
    });
    seen.themes.push({ name, value, colorScheme, paper, floor });
    await place.evaluate((node, name) => node.removeAttribute(name), name);
  }
}
for (const colorScheme of ["dark", "light"]) {
  await page.emulateMedia({ colorScheme });
  await page.waitForTimeout(150);
  const paper = await frame.locator(".replay").evaluate((node) => getComputedStyle(node).backgroundColor);
  seen.themes.push({ name: "", value: colorScheme, colorScheme, paper });
}
await browser.close();
console.log(JSON.stringify(seen));
