// Plays a replay page in Chromium and prints how many frames a second it drew, and how busy the page's thread was.
// node test/speed.mjs PAGE.html CHROMIUM WIDTH SECONDS

import { chromium } from "playwright-core";
import { pathToFileURL } from "node:url";

const [file, executablePath, width, seconds] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: Number(width), height: 900 } });
await page.goto(String(pathToFileURL(file)));
await page.waitForSelector("[data-ready='0']");
const session = await page.context().newCDPSession(page);
await session.send("Performance.enable");
const busy = async () => {
  const { metrics } = await session.send("Performance.getMetrics");
  return metrics.find(({ name }) => name === "TaskDuration").value;
};
await page.getByLabel("play").click();
const before = await busy();
const waits = await page.evaluate(async (milliseconds) => {
  const waits = [];
  const began = performance.now();
  for (let last = began; last - began < milliseconds; ) {
    await new Promise(requestAnimationFrame);
    const now = performance.now();
    waits.push(now - last);
    last = now;
  }
  return waits;
}, 1000 * Number(seconds));
const after = await busy();
await browser.close();
waits.sort((one, other) => one - other);
const total = waits.reduce((sum, each) => sum + each, 0);
console.log(
  JSON.stringify({
    frames_per_second: (1000 * waits.length) / total,
    slowest_percent_ms: waits[Math.floor(0.99 * waits.length)],
    busy_ms_per_frame: (1000 * (after - before)) / waits.length,
  }),
);
