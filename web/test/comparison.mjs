// Compares two episodes on the studio's page in Chromium, wide, dark and narrow, and prints what it saw as JSON.
// node test/comparison.mjs ADDRESS CHROMIUM FOLDER

import { createRequire } from "node:module";
import { chromium } from "playwright-core";

const [address, executablePath, folder] = process.argv.slice(2);
const axe = createRequire(import.meta.url).resolve("axe-core/axe.min.js");
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const seen = { errors: [], hosts: [], findings: [], tops: [], clocks: [], width: 0 };
for (const [width, colorScheme] of [[1200, "light"], [420, "dark"]]) {
  const page = await browser.newPage({ viewport: { width, height: 900 }, colorScheme });
  page.on("console", (message) => message.type() === "error" && seen.errors.push(message.text()));
  page.on("pageerror", (error) => seen.errors.push(String(error)));
  page.on("request", (request) => request.url().startsWith("data:") || seen.hosts.push(new URL(request.url()).host));
  await page.goto(address);
  await page.waitForSelector("[data-open=yes]");
  await page.getByText("compare two episodes").click();
  const simulate = page.getByRole("button", { name: "simulate both" });
  const note = page.locator(".studio-note").first();
  if (width > 420) {
    await page.getByRole("button", { name: "play" }).click();
    await page.locator("[name='second policy']").selectOption("go_to_goal");
    await simulate.click();
    await page.waitForFunction(() => document.querySelector(".studio-note").textContent !== "");
    seen.same = await note.textContent();
    await page.locator("[name='second episode']").fill("1");
    await simulate.click();
    await page.waitForFunction(() => document.querySelector(".studio-compare progress").value > 0);
    await page.getByText("compare two episodes").click(); // which cancels it
    await page.waitForTimeout(1500);
    seen.canceled = await page.locator(".both").count();
    await page.getByText("compare two episodes").click();
  }
  await page.locator("[name='second policy']").selectOption("expert");
  await simulate.click();
  await page.waitForFunction(() => document.querySelectorAll(".both [data-ready]").length === 2, null, { timeout: 240000 });
  seen.paused = (await page.locator(".studio-stage").getByRole("button", { name: "play" }).count()) === 1;
  seen.titles = await page.locator(".both h2").allTextContents();
  seen.columns = await page.locator(".studio-open .studio-card th").allTextContents();
  seen.tops.push(await page.locator(".both .replay").evaluateAll((all) => all.map((each) => each.getBoundingClientRect().top)));
  await page.locator(".both").getByRole("button", { name: "where they part" }).click();
  await page.waitForTimeout(300);
  seen.clocks.push((await page.locator(".both .replay-clock").allTextContents()).map(Number.parseFloat));
  await page.locator(".both").getByLabel("time").first().evaluate((slider) => {
    slider.value = "9";
    slider.dispatchEvent(new Event("input"));
  });
  await page.waitForTimeout(300);
  seen.clocks.push((await page.locator(".both .replay-clock").allTextContents()).map(Number.parseFloat));
  seen.width = Math.max(seen.width, (await page.evaluate(() => document.documentElement.scrollWidth)) - width);
  await page.screenshot({ path: `${folder}/comparison-${width}.png`, fullPage: true });
  await page.addScriptTag({ path: axe });
  const { violations } = await page.evaluate(() => window.axe.run());
  seen.findings.push(...violations.filter(({ impact }) => ["serious", "critical"].includes(impact)).map(({ id, nodes }) => `${id} ${nodes[0].target}`));
  await page.close();
}
await browser.close();
console.log(JSON.stringify(seen));
