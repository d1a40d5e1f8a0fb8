// Goes through a study as a participant in Chromium and prints what it saw as JSON.
// node test/survey.mjs LINK CHROMIUM FOLDER SCHEME WIDTH

import { createRequire } from "node:module";
import { chromium } from "playwright-core";

const [address, executablePath, folder, colorScheme, width] = process.argv.slice(2);
const axe = createRequire(import.meta.url).resolve("axe-core/axe.min.js");
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const context = await browser.newContext({ viewport: { width: Number(width), height: 900 }, colorScheme });
const seen = { errors: [], hosts: [], pages: [], findings: [], outcomes: [], texts: [], wide: [] };
const watch = (page) => {
  page.on("console", (message) => message.type() === "error" && seen.errors.push(message.text()));
  page.on("pageerror", (error) => seen.errors.push(String(error)));
  page.on("request", (request) => request.url().startsWith("data:") || seen.hosts.push(new URL(request.url()).host));
  page.on("websocket", (socket) => seen.hosts.push(new URL(socket.url()).host));
};
let page = await context.newPage();
watch(page);
const survey = page.locator("[data-survey]");
const button = (name) => page.getByRole("button", { name, exact: true });
const data = (name) => survey.getAttribute(`data-${name}`);
const until = (condition, argument) => page.waitForFunction(condition, argument, { timeout: 120000 });

const look = async (name) => {
  seen.pages.push(name);
  await page.waitForTimeout(200);
  await page.screenshot({ path: `${folder}/survey-${colorScheme}-${width}-${seen.pages.length}-${name}.png`, fullPage: true });
  await page.addScriptTag({ path: axe });
  const { violations } = await page.evaluate(() => window.axe.run());
  for (const { id, impact, nodes } of violations) {
    if (["serious", "critical"].includes(impact)) seen.findings.push({ name, id, targets: nodes.map((node) => node.target.join(" ")) });
  }
  if (await page.evaluate(() => document.documentElement.scrollWidth > innerWidth)) seen.wide.push(name);
};

/** Answer all questions of the page; with `reload`, the page is loaded again in between. */
const answer = async (reload) => {
  await page.waitForSelector(".survey-questions");
  const count = await page.locator("[data-question]").count();
  for (let k = 0; k < count; k++) {
    const place = page.locator("[data-question]").nth(k);
    const radios = place.locator("input[type=radio]");
    if (await radios.count()) await radios.nth(k % (await radios.count())).check();
    else if (await place.locator("textarea").count()) await place.locator("textarea").fill("It kept away from people; “quoted”, = 1.");
    else await place.locator("input").fill("33");
    await until(([k]) => document.querySelectorAll("[data-question]")[k].dataset.stored, [k]);
    if (reload && k === 0) {
      await page.reload();
      await page.waitForSelector(".survey-questions");
      seen.kept = await page.evaluate(() => {
        const input = document.querySelector("[data-question] input:checked, [data-question] textarea, [data-question] input");
        return input.value;
      });
    }
  }
};

await page.goto(address);
await page.waitForSelector("[data-open=yes]");
await look("consent");
await button("I agree, begin").click();
let steps = 0;
for (;;) {
  await until(([steps]) => document.querySelector("[data-survey]").dataset.page === "end" || Number(document.querySelector("[data-survey]").dataset.step) >= steps && document.querySelector("[data-survey]").dataset.page === "step", [steps]);
  if ((await data("page")) === "end") break;
  const what = await data("what");
  if (what === "watch" || what === "choose") {
    await page.waitForSelector("[data-ready='0']");
    if (!(await button("continue").isDisabled())) seen.errors.push("continue before the end");
    const faster = !seen.early; // as somebody does who knows the browser's tools
    if (faster) await page.evaluate(() => (document.querySelector("[aria-label=speed]").value = "16"));
    await page.getByRole("button", { name: "play" }).first().click();
    if (!faster) {
      await page.waitForTimeout(1500);
      await look(what);
    }
    await until(() => [...document.querySelectorAll(".survey-next")].some((each) => !each.disabled));
    await button("continue").click();
    if (faster) {
      await until(() => document.querySelector(".studio-note").textContent);
      seen.early = await page.locator(".studio-note").textContent();
    }
  } else if (what === "drive") {
    await page.waitForSelector("[data-frames='1']");
    seen.rules = await page.locator(".survey-text").last().textContent();
    await button("start").click();
    await page.waitForSelector("[data-driving=yes]", { timeout: 60000 });
    await page.keyboard.down("ArrowUp");
    await page.waitForTimeout(2500);
    await look(what);
    if (!seen.broken) { // the drive is broken off, and begins anew
      seen.broken = Number(await data("frames"));
      await page.keyboard.up("ArrowUp");
      await page.reload();
      await page.waitForSelector("[data-frames='1']");
      await button("start").click();
      await page.waitForSelector("[data-driving=yes]", { timeout: 60000 });
      await page.keyboard.down("w");
    }
    await page.waitForSelector(".survey-questions", { timeout: 120000 });
    seen.outcomes.push(await page.locator(".studio-note").textContent());
  }
  if (!seen.missing && (await page.locator("fieldset").count())) {
    await page.waitForSelector(".survey-questions");
    await button((await data("form")) && (await button("finish").count()) ? "finish" : "next").click();
    await page.waitForSelector(".missing");
    seen.missing = await page.locator(".studio-note").textContent();
  }
  await answer(steps === 0);
  await look("questions");
  steps = Number(await data("step")) + 1;
  await page.locator(".survey-questions .survey-next").click();
}
await look("end");
seen.steps = steps;
seen.texts.push(await page.locator("body").innerText());
const other = await context.newPage(); // a second tab takes over
watch(other);
await other.goto(address);
await other.waitForSelector("[data-page=end]");
await until(() => document.querySelector(".studio-note").textContent.includes("another tab"));
await browser.close();
console.log(JSON.stringify(seen));
