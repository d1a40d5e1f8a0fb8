// The page of replays: a player for each recording in it; those of a comparison share one clock.

import { Player } from "./player";
import type { Recording } from "./recording";

const BEFORE = 2; // s, before two robots part

const together: Player[] = [];
for (const place of document.querySelectorAll<HTMLElement>("[data-replay]")) {
  const text = document.getElementById(place.dataset.replay!)!.textContent!;
  const player = new Player(place, JSON.parse(text) as Recording, place.dataset.linked !== "no");
  if (place.dataset.clock) together.push(player);
  void player.start(window.parent !== window && !place.dataset.clock); // in a frame, such as a notebook's
}
for (const player of together) {
  const others = together.filter((other) => other !== player);
  player.changed = () => others.forEach((other) => void other.copy(player));
}
if (together.length === 2) {
  const [one, other] = together;
  one.button("where they part", () => {
    const time = one.divergence(other);
    one.jump(time === null ? 0 : Math.max(0, time - BEFORE));
  });
}

/** In a notebook the page is a frame, which gets the height of the page. */
function fitFrame(): void {
  try {
    const frame = window.frameElement as HTMLElement | null;
    if (frame?.dataset.fit) frame.style.height = `${Math.ceil(document.body.getBoundingClientRect().height)}px`;
  } catch {
    // a frame of another origin keeps its height
  }
}
new ResizeObserver(fitFrame).observe(document.body);
