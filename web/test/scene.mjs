// Looks at the 3-D view of the studio's page in Chromium and prints what it saw as JSON.
// node test/scene.mjs ADDRESS CHROMIUM FOLDER

import { createRequire } from "node:module";
import { chromium } from "playwright-core";

const [address, executablePath, folder] = process.argv.slice(2);
const axe = createRequire(import.meta.url).resolve("axe-core/axe.min.js");
const seen = { errors: [], hosts: [], findings: [], views: [] };

/** Of a picture of the view: pixels in the robot's orange in its middle, and the mean brightness. */
async function look(page) {
  const scene = page.locator(".studio-scene");
  const picture = (await scene.screenshot()).toString("base64");
  return page.evaluate(async (picture) => {
    const bytes = Uint8Array.from(atob(picture), (letter) => letter.charCodeAt(0));
    const image = await createImageBitmap(new Blob([bytes]));
    const canvas = new OffscreenCanvas(image.width, image.height);
    const paint = canvas.getContext("2d");
    paint.drawImage(image, 0, 0);
    const { data } = paint.getImageData(0, 0, image.width, image.height);
    const seen = { orange: 0, bright: 0 };
    for (let k = 0; k < data.length; k += 4) {
      const [red, green, blue] = data.subarray(k, k + 3);
      seen.bright += (red + green + blue) / 765 / (data.length / 4);
      const [x, y] = [((k / 4) % image.width) / image.width, Math.floor(k / 4 / image.width) / image.height];
      if (Math.abs(x - 0.5) > 0.1 || Math.abs(y - 0.6) > 0.2) continue;
      if (red < 90 || green > 0.75 * red || green < 0.35 * red || blue > 0.3 * red) continue;
      seen.orange++;
    }
    return seen;
  }, picture);
}

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
for (const [width, colorScheme] of [[1100, "light"], [420, "dark"]]) {
  const page = await browser.newPage({ viewport: { width, height: 900 }, colorScheme });
  page.on("console", (message) => message.type() === "error" && seen.errors.push(message.text()));
  page.on("pageerror", (error) => seen.errors.push(String(error)));
  page.on("request", (request) => request.url().startsWith("data:") || seen.hosts.push(new URL(request.url()).host));
  await page.goto(address);
  await page.waitForSelector("[data-open=yes]");
  await page.getByLabel("view").selectOption("3-D");
  const scene = page.locator(".studio-scene");
  await page.waitForSelector(".studio-scene[data-pictures]");
  await scene.scrollIntoViewIfNeeded();
  const settle = () => page.waitForTimeout(600);
  await settle();
  const views = [await look(page)];
  if (width > 420) {
    const box = await scene.boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    await page.mouse.move(x, y);
    await page.mouse.wheel(0, -600); // not yet focused
    await settle();
    views.push(await look(page));
    await page.mouse.down();
    await page.mouse.move(x + 120, y, { steps: 6 });
    await page.mouse.up();
    await settle();
    views.push(await look(page));
    await page.mouse.wheel(0, -600);
    await settle();
    views.push(await look(page));
    await page.mouse.dblclick(x, y);
    await page.mouse.move(0, 0);
    await settle();
    views.push(await look(page));
    seen.pictures = Number(await scene.getAttribute("data-pictures"));
    await page.getByRole("button", { name: "step", exact: true }).click();
    await page.waitForFunction((before) => Number(document.querySelector(".studio-scene").dataset.pictures) > before, seen.pictures);
  }
  seen.views.push(views);
  await page.screenshot({ path: `${folder}/scene-${width}.png` });
  await page.addScriptTag({ path: axe });
  const { violations } = await page.evaluate(() => window.axe.run());
  seen.findings.push(...violations.filter(({ impact }) => ["serious", "critical"].includes(impact)).map(({ id, nodes }) => `${id} ${nodes[0].target}`));
  await page.getByLabel("view").selectOption("none");
  seen.removed = await scene.count();
  await page.close();
}
await browser.close();

const without = await chromium.launch({ executablePath, args: ["--no-sandbox", "--disable-3d-apis"] });
const page = await without.newPage();
await page.goto(address);
await page.waitForSelector("[data-open=yes]");
seen.without = await page.getByLabel("view").locator("option[value='3-D']").evaluate((option) => [option.textContent, option.disabled]);
await without.close();
console.log(JSON.stringify(seen));
