// Pictures of a replay page, 900 x 500, for an animation such as README's: the camera follows the robot, captions name situations.
// node film.mjs PAGE.html CHROMIUM FOLDER EPISODE BEGIN END

import { mkdirSync } from "node:fs";
import { chromium } from "playwright-core";
import { pathToFileURL } from "node:url";

const [WIDTH, HEIGHT] = [900, 500];
const STEP = 0.2; // s, of the episode from one picture to the next
const HOLD = 15; // pictures, for which a caption stays at least
const CAPTIONS = {
  "join group": "the robot joins a group",
  "leave group": "the robot leaves a group",
  "cross path": "a person crosses the robot's path",
  "down path": "a person walks along the robot's path",
}; // the first that holds is shown

const [file, executablePath, folder, episode, begin, end] = process.argv.slice(2);
mkdirSync(folder, { recursive: true });
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: WIDTH, height: 1000 }, colorScheme: "light" });
await page.goto(`${pathToFileURL(file)}#episode=${episode}&t=${begin}`);
await page.waitForSelector(`[data-ready='${episode}']`);
await page.getByLabel("follow").check();
await page.addStyleTag({
  content: `
    header, .replay-bar { display: none !important; }
    main, .replay, .replay-plan { padding: 0 !important; margin: 0 !important; border: 0 !important; border-radius: 0 !important; }
    .caption { position: absolute; left: 24px; padding: 8px 18px; border-radius: 8px; border-left: 10px solid var(--light);
      background: var(--paper); font-size: 26px; }
    .caption:empty { display: none; }`,
});
await page.waitForTimeout(200);
const plan = page.locator(".replay-plan");
const box = await plan.boundingBox();
await plan.focus();
await page.mouse.move(WIDTH / 2, box.y + box.height / 2);
await page.mouse.wheel(0, -170); // nearer
await page.mouse.move(1, 990); // no name below the pointer
const top = box.y + (box.height - HEIGHT) / 2;
await page.evaluate((top) => {
  const caption = document.body.appendChild(document.createElement("div"));
  caption.className = "caption";
  caption.style.top = `${top + 24}px`;
}, top);
let [shown, since] = ["", -HOLD];
for (let index = 0; Number(begin) + index * STEP <= Number(end) + 1e-6; index++) {
  await page.evaluate((hash) => (location.hash = hash), `#episode=${episode}&t=${(Number(begin) + index * STEP).toFixed(2)}`);
  await page.waitForTimeout(60);
  const lights = await page.locator(".replay-light.on").allTextContents();
  const next = Object.keys(CAPTIONS).find((name) => lights.includes(name)) ?? "";
  if (next !== shown && (!shown || index - since >= HOLD)) [shown, since] = [next, index];
  await page.evaluate(([name, text]) => {
    const caption = document.querySelector(".caption");
    const light = [...document.querySelectorAll(".replay-light")].find((each) => each.textContent === name);
    if (light) caption.style.setProperty("--light", light.style.getPropertyValue("--light"));
    caption.textContent = text;
  }, [shown, CAPTIONS[shown] ?? ""]);
  await page.screenshot({ path: `${folder}/${String(index).padStart(4, "0")}.png`, clip: { x: 0, y: top, width: WIDTH, height: HEIGHT } });
}
await browser.close();
