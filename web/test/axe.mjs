// Serious accessibility findings of a page in Chromium, light and dark, as JSON.
// node test/axe.mjs ADDRESS CHROMIUM

import { createRequire } from "node:module";
import { chromium } from "playwright-core";

const [address, executablePath] = process.argv.slice(2);
const axe = createRequire(import.meta.url).resolve("axe-core/axe.min.js");
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const found = [];
for (const colorScheme of ["light", "dark"]) {
  const page = await browser.newPage({ viewport: { width: 420, height: 900 }, colorScheme });
  await page.goto(address);
  await page.waitForSelector("[data-open=yes], [data-ready], [data-views]");
  const edit = page.getByRole("button", { name: "edit", exact: true });
  if (await edit.count()) await edit.click();
  for (const panel of await page.locator(".studio-open summary").all()) await panel.click();
  await page.waitForTimeout(300);
  await page.addScriptTag({ path: axe });
  const { violations } = await page.evaluate(() => window.axe.run());
  for (const { id, impact, nodes } of violations) {
    if (["serious", "critical"].includes(impact)) found.push({ colorScheme, id, impact, targets: nodes.map((node) => node.target.join(" ")) });
  }
  await page.close();
}
await browser.close();
console.log(JSON.stringify(found));
