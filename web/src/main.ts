// The page of replays: a player for each recording in it; those of a comparison share one clock.

import { shareClock } from "./compare";
import { Player } from "./player";
import type { Recording } from "./recording";

const together: Player[] = [];
for (const place of document.querySelectorAll<HTMLElement>("[data-replay]")) {
  const text = document.getElementById(place.dataset.replay!)!.textContent!;
  const player = new Player(place, JSON.parse(text) as Recording, place.dataset.linked !== "no");
  if (place.dataset.clock) together.push(player);
  void player.start(window.parent !== window && !place.dataset.clock); // in a frame, such as a notebook's
}
shareClock(together);

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
