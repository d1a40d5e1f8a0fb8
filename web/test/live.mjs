// Opens the page of a live episode in Chromium and prints what it saw as JSON.
// node test/live.mjs ADDRESS CHROMIUM FRAMES

import { chromium } from "playwright-core";

const [address, executablePath, frames] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1100, height: 900 } });
const seen = { errors: [], hosts: [], grew: [] };
page.on("console", (message) => message.type() === "error" && seen.errors.push(message.text()));
page.on("pageerror", (error) => seen.errors.push(String(error)));
page.on("request", (request) => request.url().startsWith("data:") || seen.hosts.push(new URL(request.url()).host));

await page.goto(address);
await page.keyboard.press("End"); // there may be no frame yet
seen.first = await page.locator(".replay-outcome").textContent();
for (let done = 0; done < Number(frames); ) {
  await page.waitForFunction((least) => Number(document.querySelector(".replay").dataset.frames) > least, done);
  done = Number(await page.locator(".replay").getAttribute("data-frames"));
  seen.grew.push(done);
  if (seen.grew.length === 1) {
    await page.waitForTimeout(300);
    seen.playing = (await page.getByLabel("pause").count()) > 0;
    console.log("grown");
  }
}
await page.waitForFunction(() => document.querySelector(".replay-outcome").textContent.includes("completed"));
seen.outcome = await page.locator(".replay-outcome").textContent();
seen.duration = Number.parseFloat((await page.locator(".replay-clock").textContent()).split("of")[1]);
seen.drawn = await page.evaluate(() => {
  const canvas = document.querySelector(".replay-plan");
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return new Set(new Uint32Array(pixels.buffer)).size;
});
await browser.close();
console.log(JSON.stringify(seen));
