// Time from a key to the robot's motion on the studio's page, and pictures a second, in Chromium, as JSON.
// node test/latency.mjs ADDRESS CHROMIUM

import { chromium } from "playwright-core";

const [address, executablePath] = process.argv.slice(2);
const KEYS = 40;
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1100, height: 950 } });
await page.goto(address);
await page.waitForSelector("[data-open=yes]");
await page.getByLabel("view").selectOption("depth");
await page.getByRole("button", { name: "drive", exact: true }).click();
await page.waitForSelector("[data-human=yes]");
await page.waitForSelector("[data-picture=depth]");
const times = [];
for (let k = 0; k < KEYS; k++) {
  const key = k % 2 ? "s" : "w";
  const time = await page.evaluate(
    (key) =>
      new Promise((done) => {
        const root = document.querySelector("[data-studio]");
        const began = performance.now();
        window.dispatchEvent(new KeyboardEvent("keydown", { key }));
        const look = () => {
          if (Number(root.dataset.speed) > 0.004) requestAnimationFrame(() => done(performance.now() - began));
          else setTimeout(look, 1);
        };
        look();
      }),
    key,
  );
  times.push(time);
  await page.waitForTimeout(200);
  await page.evaluate((key) => window.dispatchEvent(new KeyboardEvent("keyup", { key })), key);
  await page.waitForFunction(() => Number(document.querySelector("[data-studio]").dataset.speed) < 0.003);
  await page.waitForTimeout(100 + 97 * Math.random());
}
times.sort((a, b) => a - b);
const seen = await page.evaluate(async () => {
  const root = document.querySelector("[data-studio]");
  const [began, tick] = [performance.now(), Number(root.dataset.frames)];
  let drawn = 0;
  while (performance.now() - began < 5000) {
    await new Promise(requestAnimationFrame);
    drawn++;
  }
  return { drawn: drawn / 5, steps: (Number(root.dataset.frames) - tick) / 5 };
});
const at = (share) => Math.round(times[Math.floor(share * (KEYS - 1))]);
console.log(JSON.stringify({ median: at(0.5), p95: at(0.95), most: at(1), ...seen }));
await browser.close();
