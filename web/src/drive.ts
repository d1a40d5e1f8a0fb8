// A person's command, from keys, a gamepad or a touch.

import { add } from "./player";

export const COMMAND_INTERVAL = 50; // ms from one command to the next
const RAMP = 4; // 1/s, at which keys reach their full command
const DEAD_ZONE = 0.12; // of a stick
const KEYS: Record<string, [number, number]> = {
  w: [1, 0],
  ArrowUp: [1, 0],
  s: [-1, 0],
  ArrowDown: [-1, 0],
  a: [0, 1],
  ArrowLeft: [0, 1],
  d: [0, -1],
  ArrowRight: [0, -1],
};

/** Whether keys belong to what has the focus: text and numbers are typed there. */
function isTyped(target: EventTarget | null): boolean {
  if (target instanceof HTMLTextAreaElement) return true;
  const others = ["checkbox", "radio", "range", "button", "submit", "reset", "file", "color"];
  return target instanceof HTMLInputElement && !others.includes(target.type);
}

/** The person's command, from keys that are down, a stick or a touch: shares of the limits, ahead and to the left. */
export class Controls {
  active = true; // whether keys drive, or scroll the page
  private readonly down = new Set<string>();
  private stick: [number, number] | null = null; // of the touch joystick
  private command: [number, number] = [0, 0];

  constructor(joystick: HTMLElement, changed: () => void) {
    window.addEventListener("keydown", (event) => {
      const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
      if (!this.active || !(key in KEYS) || event.ctrlKey || event.metaKey || event.altKey || isTyped(event.target)) return;
      event.preventDefault();
      if (this.down.has(key)) return; // held down
      this.down.add(key);
      changed();
    });
    window.addEventListener("keyup", (event) => {
      if (this.down.delete(event.key.length === 1 ? event.key.toLowerCase() : event.key)) changed();
    });
    window.addEventListener("change", (event) => {
      // after a click on a box or a list, keys drive again
      if (this.active && event.target instanceof HTMLElement && !isTyped(event.target)) event.target.blur();
    });
    window.addEventListener("blur", () => {
      this.down.clear();
      changed();
    });
    const knob = add(joystick, "span");
    const move = (event: PointerEvent): void => {
      const box = joystick.getBoundingClientRect();
      const x = (2 * (event.clientX - box.left)) / box.width - 1;
      const y = (2 * (event.clientY - box.top)) / box.height - 1;
      const far = Math.max(1, Math.hypot(x, y));
      this.stick = [-y / far, -x / far];
      knob.style.transform = `translate(${(x / far) * 40}px, ${(y / far) * 40}px)`;
    };
    const leave = (): void => {
      this.stick = null;
      knob.style.transform = "";
    };
    joystick.addEventListener("pointerdown", (event) => {
      joystick.setPointerCapture(event.pointerId);
      move(event);
    });
    joystick.addEventListener("pointermove", (event) => this.stick && move(event));
    joystick.addEventListener("pointerup", leave);
    joystick.addEventListener("pointercancel", leave);
  }

  /** The command after some more seconds. */
  next(seconds: number): [number, number] {
    const pad = this.gamepad();
    if (pad) this.command = pad;
    else if (this.stick) this.command = this.stick;
    else {
      const sum: [number, number] = [0, 0];
      for (const key of this.down) {
        sum[0] += KEYS[key][0];
        sum[1] += KEYS[key][1];
      }
      this.command = this.command.map((now, k) => {
        const goal = Math.max(-1, Math.min(1, sum[k]));
        if (goal === 0) return 0; // a key that is released stops at once
        return now + Math.max(-RAMP * seconds, Math.min(RAMP * seconds, goal - now));
      }) as [number, number];
    }
    return this.command;
  }

  /** The first gamepad's left stick while one of its shoulder buttons is held: it may lie on a table. */
  private gamepad(): [number, number] | null {
    for (const pad of navigator.getGamepads?.() ?? []) {
      if (!pad || !(pad.buttons[4]?.pressed || pad.buttons[5]?.pressed)) continue;
      const share = (value: number): number =>
        Math.abs(value) < DEAD_ZONE ? 0 : (Math.sign(value) * (Math.abs(value) - DEAD_ZONE)) / (1 - DEAD_ZONE);
      return [-share(pad.axes[1]), -share(pad.axes[0])];
    }
    return null;
  }
}

/** Draw a picture of the robot's camera. */
export function paintPicture(canvas: HTMLCanvasElement, width: number, height: number, bytes: Uint8Array): void {
  [canvas.width, canvas.height] = [width, height];
  const image = new ImageData(width, height);
  for (let k = 0, p = 0; k < image.data.length; k += 4, p += 3) {
    image.data.set(bytes.subarray(p, p + 3), k);
    image.data[k + 3] = 255;
  }
  canvas.getContext("2d")!.putImageData(image, 0, 0);
}
