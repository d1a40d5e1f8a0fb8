// Edits the files of a copy of the lab in the studio's page in Chromium and prints what it saw as JSON.
// node test/edit.mjs ADDRESS CHROMIUM FOLDER [PICTURE]: with behavior graph; with handcrafted sets, their places

import { chromium } from "playwright-core";

const [address, executablePath, folder, picture] = process.argv.slice(2);
const FLOOR = [-6.4, -3, 4.6, 3.4]; // m, of the lab
const LONG = { timeout: 240000 }; // a compile
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1100, height: 1100 } });
const seen = { errors: [], seconds: {} };
page.on("console", (message) => message.type() === "error" && seen.errors.push(message.text()));
page.on("pageerror", (error) => seen.errors.push(String(error)));
const differs = (part, there = true) =>
  page.waitForFunction(
    ([part, there]) => document.querySelector("[data-studio]").dataset.difference.includes(part) === there,
    [part, there],
    LONG,
  );
const timed = async (name, act) => {
  const begin = performance.now();
  await act();
  seen.seconds[name] = Number(((performance.now() - begin) / 1000).toFixed(2));
};
const tick = async () => Number(await page.locator("[data-studio]").getAttribute("data-tick"));
const press = (name) => page.getByRole("button", { name, exact: true }).click();
const note = (part) =>
  page.waitForFunction((part) => document.querySelector(".studio-bubble").textContent.includes(part), part, LONG);

process.on("uncaughtException", async (error) => {
  console.error(error, await page.locator(".studio-note").first().textContent(), await page.locator(".studio-edit pre").textContent());
  process.exit(1);
});
await page.goto(address);
await page.waitForSelector("[data-open=yes]");
await press("edit");
await press("play");
let [box, scale] = [null, 1];
const measure = async () => {
  box = await page.locator(".replay-plan").boundingBox(); // the table at an episode's end moves it
  scale = 0.96 * Math.min(box.width / (FLOOR[2] - FLOOR[0]), box.height / (FLOOR[3] - FLOOR[1]));
};
const at = (x, y) => [
  box.x + box.width / 2 + (x - (FLOOR[0] + FLOOR[2]) / 2) * scale,
  box.y + box.height / 2 - (y - (FLOOR[1] + FLOOR[3]) / 2) * scale,
];
const drag = async (from, to) => {
  await measure();
  await page.mouse.move(...at(...from));
  await page.mouse.down();
  await page.mouse.move(...at((from[0] + to[0]) / 2, (from[1] + to[1]) / 2));
  await page.mouse.move(...at(...to));
  await page.mouse.up();
};
const click = async (x, y) => {
  await measure();
  await page.mouse.click(...at(x, y));
};
await measure();
const red = ([x, y]) => {
  const plan = document.querySelector(".replay-plan");
  const [r, g, b] = plan.getContext("2d").getImageData(x * devicePixelRatio, y * devicePixelRatio, 1, 1).data;
  return r > g + 40 && r > b + 40;
};
seen.sets = await page.getByRole("button", { name: "sets", exact: true }).count();

if (seen.sets) {
  await page.getByLabel("set").selectOption("empty_1");
  await timed("goal", async () => {
    await drag([2.9, -0.4], [2.7, -0.2]); // its first goal
    await differs("[2.7, -0.2, 0]");
  });
  seen.before = await tick();
  await page.getByLabel("heading, °").fill("45");
  await page.getByLabel("heading, °").press("Enter");
  await differs("[2.7, -0.2, 45]");
  await drag([-4.7, 1.6], [-4.7, 1.3]); // a place of the loop
  await differs("[-4.7, 1.3]");
  await drag([2.7, -0.2], [-6.3, 0]); // into a wall
  await note("inside an obstacle");
  seen.note = await page.locator(".studio-bubble").textContent();
  await page.screenshot({ path: `${folder}/sets.png` });
  await press("undo");
  await differs("[-4.7, 1.3]", false);
  seen.after = await tick();
} else {
  const [door, moved, corner] = [[-3.113, -0.837], [-2.5, -0.5], [-2.698, 1.844]];
  await drag(door, moved);
  await differs("+  door");
  seen.before = await tick();
  await timed("node", async () => {
    await drag(moved, [-2.6, -0.5]);
    await differs("[-2.6, -0.5]");
  });
  await drag([-2.6, -0.5], moved);
  await differs("[-2.5, -0.5]");
  await click((moved[0] + corner[0]) / 2, (moved[1] + corner[1]) / 2);
  await differs("high");
  await drag(moved, [-6.0, 2.9]);
  await note("obstacle");
  seen.note = await page.locator(".studio-bubble").textContent();
  await page.screenshot({ path: `${folder}/note.png` });
  await click(...moved);
  await page.getByLabel("radius, m").fill("0.75");
  await page.getByLabel("radius, m").press("Enter");
  await differs("0.75");
  await press("undo");
  await differs("0.75", false);
  seen.after = await tick();
  await click(...corner); // it gets the edge
  await press("add node");
  await page.getByLabel("name").fill("east");
  await timed("new node", async () => {
    await click(0.6, 1.2);
    await differs("east: {kind: waypoint");
  });
  await timed("new edge", async () => {
    await drag([0.6 - 0.5, 1.2], [2.526, 0.245]); // from its rim
    await differs("[east, meeting]");
  });
  await page.screenshot({ path: `${folder}/edit.png` });

  await press("obstacles");
  await click(1.5, 1.85); // the screen: 0.6 by 0.1 m
  await timed("obstacle", async () => {
    await page.getByLabel("turn, °").fill("5");
    await page.getByLabel("turn, °").press("Enter");
    await differs('euler="0 0 5"');
  });
  await press("undo");
  await differs('euler="0 0 5"', false);
  await drag([1.5, 1.85], [1.9, 2.0]);
  await differs('pos="1.9 2 0.9"');
  await drag([1.9, 2.05 + 28 / scale], [1.9 - 1, 2.0]); // its handle to the left: a quarter turn
  await differs('euler="0 0 90"');
  await drag([1.9, 2.3], [1.9, 2.4]); // the side that is ahead now
  await differs('size="0.35 0.05 0.9"');
  await page.screenshot({ path: `${folder}/obstacles.png` });
  await press("add box");
  await click(3.1, 1.9); // where no node is near, of trips either
  await differs('name="box_1"');
  await press("remove box");
  await differs('name="box_1"', false);

  await press("backdrop");
  await page.getByLabel("picture").setInputFiles(picture);
  await page.getByText("40 × 20").waitFor();
  await measure();
  await page.waitForFunction(red, [box.width / 2, box.height / 2], LONG); // a person may stand on it for a while
  seen.far = await page.evaluate(red, [box.width / 2 + 3.9 * scale, 12]);
  await press("two points");
  await click(-2, 0);
  await click(-1, 0);
  await page.getByLabel("distance, m").fill("0.5");
  await page.getByLabel("distance, m").press("Enter");
  await drag([-1.5, 0], [-1.5, 1.5]);
  await page.waitForTimeout(200);
  await page.screenshot({ path: `${folder}/backdrop.png` });
  seen.scale = Number(await page.getByLabel("metres a pixel").inputValue());
}
await press("save");
await page.waitForFunction(() => !document.querySelector("[data-studio]").dataset.difference, null, LONG);
await browser.close();
console.log(JSON.stringify(seen));
