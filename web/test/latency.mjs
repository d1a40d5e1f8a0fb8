// Time from a key to the robot's motion on the studio's page, and pictures a second, in Chromium, as JSON.
// node test/latency.mjs ADDRESS CHROMIUM [FILE]; the file keeps the figures of other scenarios, by their commands.

import { existsSync, readFileSync, renameSync, writeFileSync } from "node:fs";
import { cpus, loadavg } from "node:os";
import { chromium } from "playwright-core";

const [address, executablePath, file] = process.argv.slice(2);
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
const rates = async (view) => {
  await page.getByLabel("view").selectOption(view);
  await page.waitForTimeout(1500);
  return page.evaluate(async () => {
    const root = document.querySelector("[data-studio]");
    const pictures = () => Number(document.querySelector(".studio-scene")?.dataset.pictures ?? 0);
    const [began, tick, first] = [performance.now(), Number(root.dataset.frames), pictures()];
    let drawn = 0;
    while (performance.now() - began < 5000) {
      await new Promise(requestAnimationFrame);
      drawn++;
    }
    return { drawn: drawn / 5, steps: (Number(root.dataset.frames) - tick) / 5, scene: (pictures() - first) / 5 };
  });
};
const { drawn, steps } = await rates("depth");
const { scene } = await rates("3-D");
const at = (share) => Math.round(times[Math.floor(share * (KEYS - 1))]);
const figures = { median_ms: at(0.5), p95_ms: at(0.95), most_ms: at(1), plan_per_second: drawn, steps_per_second: steps, scene_per_second: scene };
const machine = { cores: cpus().length, load: Number(loadavg()[0].toFixed(1)), chromium: browser.version() };
const command = await page.evaluate(() => document.querySelector(".studio-command").textContent);
console.log(JSON.stringify({ ...figures, ...machine }));
if (file) {
  const all = existsSync(file) ? JSON.parse(readFileSync(file, "utf8")) : {};
  writeFileSync(`${file}.new`, JSON.stringify({ ...all, [command]: { ...figures, ...machine } }, null, 2) + "\n");
  renameSync(`${file}.new`, file);
}
await browser.close();
