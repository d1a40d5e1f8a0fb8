// Opens a replay page in Chromium, uses it as a person would, and prints what it saw as JSON.
// node test/page.mjs PAGE.html CHROMIUM [SCREENSHOT.png]

import { chromium } from "playwright-core";
import { pathToFileURL } from "node:url";
import { drawn } from "./drawn.mjs";

const [file, executablePath, picture] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1100, height: 900 } });
const seen = { errors: [], requests: [] };
page.on("console", (message) => message.type() === "error" && seen.errors.push(message.text()));
page.on("pageerror", (error) => seen.errors.push(String(error)));
page.on("request", (request) => request.url().startsWith("data:") || seen.requests.push(request.url().split("#")[0]));
const clock = async () => Number.parseFloat(await page.locator(".replay-clock").first().textContent());

await page.goto(`${pathToFileURL(file)}#episode=1&t=2`);
await page.waitForSelector("[data-ready='1']");
await drawn(page);
seen.linked = await clock();
await page.selectOption(".replay-bar select", "0");
await page.waitForSelector("[data-ready='0']");
await drawn(page);
seen.opened = await clock();
await page.locator(".replay-plan").focus();
await page.keyboard.press("Shift+ArrowRight");
await drawn(page);
seen.stepped = await clock();
const track = page.locator(".replay-track input");
const { width, height } = await track.boundingBox();
await track.click({ position: { x: width / 2, y: height / 2 } });
await drawn(page);
seen.scrubbed = await clock();
seen.duration = Number.parseFloat((await page.locator(".replay-clock").first().textContent()).split("of")[1]);
seen.lit = await page.locator(".replay-light.on").allTextContents();
seen.labels = await page.locator(".replay-light").evaluateAll((all) => all.map((each) => each.getBoundingClientRect().toJSON()));
await page.keyboard.press("Home");
await page.selectOption(".replay-controls select", "1");
await page.getByLabel("play").click();
[seen.played, seen.passed, seen.slowest] = await page.evaluate(async () => {
  const clock = () => Number.parseFloat(document.querySelector(".replay-clock").textContent);
  const [began, first] = [await new Promise(requestAnimationFrame), clock()];
  let [now, slowest] = [began, 0];
  for (let count = 0; count < 6 || now - began < 1000; count++) {
    const next = await new Promise(requestAnimationFrame);
    [now, slowest] = [next, Math.max(slowest, next - now)];
  }
  return [clock() - first, (now - began) / 1000, slowest / 1000];
});
await page.getByLabel("pause").click();
await page.getByLabel("legend").check();
seen.legend = await page.locator(".replay-legend").innerText();
seen.named = [];
const plan = await page.locator(".replay-plan").boundingBox();
const tip = () => page.locator(".replay-tip").textContent();
const places = []; // where a person may be: the label is that of the last drawing, which may lag by a place
for (let k = 0; k < 900; k++) {
  const place = [plan.x + ((k % 30) / 30) * plan.width, plan.y + (Math.floor(k / 30) / 30) * plan.height];
  await page.mouse.move(...place);
  seen.named.push(await tip());
  if (seen.named.at(-1).startsWith("person")) places.push(place, [place[0] - plan.width / 30, place[1]]);
}
seen.named = [...new Set(seen.named)];
let person = null;
while (!person && places.length) {
  const place = places.pop();
  await page.mouse.move(...place);
  await drawn(page);
  if ((await tip()).startsWith("person")) person = place;
}
if (person) {
  const change = async (before) => { // the label after the next drawing, or unchanged after 30 s
    const other = (text) => document.querySelector(".replay-pin").textContent !== text;
    await page.waitForFunction(other, before).catch(() => {});
    return page.locator(".replay-pin").textContent();
  };
  await page.mouse.click(...person);
  await page.mouse.move(plan.x + 2, plan.y + 2);
  seen.pinned = await change("");
  await page.keyboard.press("End");
  seen.later = await change(seen.pinned);
  await page.mouse.click(plan.x + 2, plan.y + 2);
  seen.unpinned = await change(seen.later);
}
await page.getByLabel("follow").check();
await drawn(page);
seen.drawn = await page.evaluate(() => {
  const canvas = document.querySelector(".replay-plan");
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return new Set(new Uint32Array(pixels.buffer)).size;
});
for (const reducedMotion of ["no-preference", "reduce"]) {
  await page.emulateMedia({ reducedMotion });
  await page.goto("about:blank");
  await page.goto(`${pathToFileURL(file)}#play`);
  await page.waitForSelector("[data-ready]");
  await drawn(page);
  (seen.moves ??= []).push((await page.getByLabel("pause").count()) > 0);
}
if (picture) await page.screenshot({ path: picture, fullPage: true });
await browser.close();
console.log(JSON.stringify(seen));
