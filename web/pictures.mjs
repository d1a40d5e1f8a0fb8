// The pictures of docs/studio.md: a policy drives an episode in a copy of the lab.
// sean studio --environment ./lab --people 8
// node web/pictures.mjs ADDRESS CHROMIUM docs/pictures

import { chromium } from "playwright-core";

const [address, executablePath, folder] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1100, height: 1000 }, colorScheme: "light" });
const button = (name) => page.getByRole("button", { name, exact: true });
await page.goto(address);
await page.waitForSelector("[data-open=yes]");

await page.getByLabel("view").selectOption("3-D");
await button("play").click();
await page.waitForFunction(() => Number(document.querySelector("[data-studio]").dataset.tick) > 80, null, { timeout: 60000 });
await button("pause").click();
await page.waitForTimeout(1000);
const stage = await page.locator(".studio-stage").boundingBox();
await page.screenshot({ path: `${folder}/studio-3d.png`, clip: { ...stage, height: 640 } });

await page.getByLabel("view").selectOption("third_person");
await button("play").click();
await page.waitForFunction(() => document.querySelectorAll(".studio-card th").length > 10, null, { timeout: 180000 });
await page.waitForFunction(() => document.querySelectorAll(".studio-card thead th").length >= 3, null, { timeout: 400000 });
await page.waitForTimeout(1000);
await page.screenshot({ path: `${folder}/studio.png`, clip: { x: 0, y: 0, width: 1100, height: 1200 }, fullPage: true });

await page.getByText("compare two episodes").click();
await page.locator("[name='second policy']").selectOption("expert");
await button("simulate both").click();
await page.waitForFunction(() => document.querySelectorAll(".both [data-ready]").length === 2, null, { timeout: 240000 });
await page.locator(".both").getByLabel("time").first().evaluate((slider) => {
  slider.value = "9";
  slider.dispatchEvent(new Event("input"));
});
await page.waitForTimeout(500);
await page.locator(".studio-open").nth(1).screenshot({ path: `${folder}/studio-compare.png` });
await page.getByText("compare two episodes").click();
await browser.close();
