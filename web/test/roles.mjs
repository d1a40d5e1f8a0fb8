// Two tabs of the studio's page in Chromium, with a real mouse: who drives, with what keys, and what stays after a
// reload; prints what it saw as JSON.
// node test/roles.mjs ADDRESS CHROMIUM FOLDER

import { chromium } from "playwright-core";

const [address, executablePath, folder] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const context = await browser.newContext({ viewport: { width: 1100, height: 900 } });
const [one, two] = [await context.newPage(), await context.newPage()];
const seen = { errors: [], speeds: {}, sent: 0 };
for (const page of [one, two]) {
  page.on("console", (message) => message.type() === "error" && seen.errors.push(message.text()));
  page.on("pageerror", (error) => seen.errors.push(String(error)));
}
two.on("websocket", (socket) => socket.on("framesent", ({ payload }) => (seen.sent += String(payload).includes("command"))));
const role = (page, you) => page.waitForSelector(`[data-you=${you}]`);
const state = (page) => page.locator(".studio-state").textContent();
const disabled = (page) => page.locator(".studio-bar button:disabled").allTextContents();
const click = async (page, locator) => { // as a hand does it
  const { x, y, width, height } = await locator.boundingBox();
  await page.mouse.click(x + width / 2, y + height / 2);
};
const button = (page, name) => page.getByRole("button", { name, exact: true });
const speed = (page, test) =>
  page.waitForFunction(test, null, { timeout: 20000 }).then(() => true, () => false);
const moves = (page) => speed(page, () => Number(document.querySelector("[data-studio]").dataset.speed) > 0.1);
const stands = (page) => speed(page, () => Math.abs(Number(document.querySelector("[data-studio]").dataset.speed)) < 0.02);

await one.goto(address);
await role(one, "free");
seen.free = await state(one);
const three = await context.newPage(); // of a studio that does not answer yet
await three.routeWebSocket(/socket/, () => {});
await three.goto(address);
seen.connecting = [await state(three), await disabled(three), await three.locator(".studio-note").first().textContent()];
await three.close();
await click(one, button(one, "record"));
await click(one, button(one, "drive"));
await role(one, "driver");
await two.goto(address);
await role(two, "watcher");

// keys drive after a click on a box, a list, the timeline and a button
const places = {
  box: one.getByLabel("follow"),
  list: one.getByLabel("speed"),
  timeline: one.getByLabel("time"),
  moment: button(one, "newest moment"),
};
const list = await one.getByLabel("speed").inputValue();
for (const [name, place] of Object.entries(places)) {
  await click(one, place);
  if (name === "list") await one.keyboard.press("Escape"); // closes the list, which keeps the focus
  await one.keyboard.down("w");
  seen.speeds[name] = await moves(one);
  await one.keyboard.up("w");
  await stands(one);
}
await one.keyboard.press("ArrowUp");
seen.list = (await one.getByLabel("speed").inputValue()) === list;
await one.keyboard.down("s");
seen.speeds.back = await moves(one);
await one.keyboard.up("s");

// the other tab watches
seen.watching = [await state(two), await disabled(two), await two.locator(".studio-note").first().textContent()];
await two.screenshot({ path: `${folder}/watching.png` });
await one.reload();
await role(one, "driver");
seen.reloaded = [await state(one), await state(two)];
await click(two, button(two, "take the wheel"));
await role(two, "driver");
seen.taken = await state(one);
await click(one, button(one, "take the wheel"));
await role(one, "driver");

// the end: the metrics are there after a reload, and the plan does not move
const top = async () => (await one.locator(".replay-plan").boundingBox()).y;
await click(one, button(one, "give back"));
await one.getByLabel("speed").selectOption("16");
await click(one, button(one, "play"));
const before = await top();
await one.waitForFunction(() => document.querySelectorAll(".studio-side thead th").length === 4, null, { timeout: 240000 });
seen.moved = Math.abs((await top()) - before);
seen.cards = await one.locator(".studio-side thead th").allTextContents();
seen.rows = await one.locator(".studio-side tbody tr").allTextContents();
await one.screenshot({ path: `${folder}/end.png` });
await one.reload();
await one.waitForFunction(() => document.querySelectorAll(".studio-side thead th").length === 4, null, { timeout: 20000 });
await role(one, "driver");

// the list of drives
await click(one, one.getByText("recorded drives: 1"));
seen.drive = await one.locator(".studio-drives tbody td").allTextContents();
const name = one.getByLabel("name of drive 000000");
await click(one, name);
await one.keyboard.type("was wd");
await one.keyboard.press("Enter");
await two.getByText("recorded drives: 1").click();
await two.waitForFunction(() => document.querySelector(".studio-drives input")?.value === "was wd");
await one.screenshot({ path: `${folder}/drives.png`, fullPage: true });
await click(one, one.getByRole("button", { name: "discard drive 000000" }));
await one.getByText("recorded drives: 0").waitFor();

// a view says what it is, and nothing of another one stays below its name
await one.getByLabel("view").selectOption("lidar");
await one.waitForSelector("[data-picture=lidar]", { timeout: 120000 });
await one.getByLabel("view").selectOption("depth");
seen.preparing = await one.evaluate(() => {
  const canvas = document.querySelector(".studio-side canvas");
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return [document.querySelector("[data-studio]").dataset.picture ?? "none", pixels.some((value) => value > 0)];
});
await one.getByText("preparing depth (first time)").waitFor();
await one.waitForSelector("[data-picture=depth]", { timeout: 120000 });
seen.caption = await one.locator(".studio-side > .studio-note").textContent();
await one.screenshot({ path: `${folder}/view.png` });
await browser.close();
console.log(JSON.stringify(seen));
