// A picture of a floor below the plan, as an aid for drawing. It stays in this page until it is closed.

import type { Desk, Edits, Layer } from "./edit";
import type { Brush } from "./plan";
import { add } from "./player";

const MAX_BYTES = 20_000_000; // of a file
const MAX_SIDE = 4096; // pixels; a larger picture is made smaller

interface Picture {
  image: ImageBitmap;
  name: string;
  pixels: number; // of the file, along its width
  x: number; // m, of its middle
  y: number;
  scale: number; // m, of a pixel of the file
  opacity: number;
}

let picture: Picture | null = null; // also of the next scenario

export class Backdrop implements Layer {
  readonly name = "backdrop";
  readonly help = "A picture of a floor, PNG or JPEG, below the plan. Drag it. It is not uploaded and not saved.";
  private offset: [number, number] | null = null;
  private ends: [number, number][] | null = null; // m, of a distance that is known
  private error = "";

  constructor(private readonly desk: Desk) {}

  has(_: Edits): boolean {
    return true;
  }

  show(_: Edits): void {}

  down(x: number, y: number): boolean {
    if (!picture) return false;
    if (this.ends) {
      if (this.ends.length === 2) this.ends = [];
      this.ends.push([x, y]);
      return true;
    }
    const [wide, deep] = size(picture);
    if (Math.abs(x - picture.x) > wide / 2 || Math.abs(y - picture.y) > deep / 2) return false;
    this.offset = [picture.x - x, picture.y - y];
    return true;
  }

  move(x: number, y: number): void {
    if (picture && this.offset) [picture.x, picture.y] = [x + this.offset[0], y + this.offset[1]];
  }

  up(): void {
    this.offset = null;
  }

  draw: Brush = (paint, camera, palette) => {
    if (!picture) return;
    const [wide, deep] = size(picture);
    const [left, top] = camera.toScreen(picture.x - wide / 2, picture.y + deep / 2);
    paint.globalAlpha = picture.opacity;
    paint.drawImage(picture.image, left, top, wide * camera.scale, deep * camera.scale);
    paint.globalAlpha = 1;
    if (!this.ends) return;
    [paint.lineWidth, paint.strokeStyle] = [2, palette.robot];
    paint.beginPath();
    for (const end of this.ends) paint.lineTo(...camera.toScreen(...end));
    paint.stroke();
    for (const end of this.ends) {
      paint.beginPath();
      paint.arc(...camera.toScreen(...end), 5, 0, 2 * Math.PI);
      paint.stroke();
    }
  };

  fields(): void {
    const { desk } = this;
    const label = add(desk.panel, "label");
    label.append("picture ");
    const input = add(label, "input");
    input.type = "file";
    input.accept = "image/png,image/jpeg";
    input.addEventListener("change", () => input.files?.[0] && void this.open(input.files[0]));
    if (this.error) desk.title(this.error);
    if (!picture) return;
    const shown = picture;
    desk.title(shown.name);
    desk.field("metres a pixel", shown.scale, (scale) => {
      if (scale > 0) shown.scale = scale;
      desk.refresh();
    });
    const opacity = add(desk.panel, "label");
    opacity.append("opacity ");
    const range = add(opacity, "input");
    [range.type, range.min, range.max, range.step, range.value] = ["range", "0.1", "1", "0.05", String(shown.opacity)];
    range.addEventListener("input", () => {
      shown.opacity = Number(range.value);
      desk.player.redraw(false);
    });
    if (this.ends?.length === 2) {
      const [a, b] = this.ends;
      const distance = Math.hypot(a[0] - b[0], a[1] - b[1]);
      desk.field("distance, m", distance, (metres) => {
        if (metres > 0 && distance > 0) stretch(shown, a, metres / distance);
        this.ends = null;
        desk.refresh();
      });
    }
    const measure = this.ends ? "Click two points, then type their distance." : "two points";
    desk.button(measure, () => {
      this.ends = this.ends ? null : [];
      desk.refresh();
    }, this.ends !== null);
    desk.button("remove picture", () => {
      picture = this.ends = null;
      desk.refresh();
    });
  }

  private async open(file: File): Promise<void> {
    this.error = file.size > MAX_BYTES ? `The picture has more than ${MAX_BYTES / 1e6} MB.` : "";
    if (!this.error) {
      try {
        let image = await createImageBitmap(file);
        const { width, height } = image;
        const share = MAX_SIDE / Math.max(width, height);
        if (share < 1) {
          const [resizeWidth, resizeHeight] = [width, height].map((side) => Math.max(1, Math.round(side * share)));
          image = await createImageBitmap(image, { resizeWidth, resizeHeight });
        }
        const [x0, y0, x1, y1] = this.desk.recording.place.floor;
        const scale = Math.min((x1 - x0) / width, (y1 - y0) / height);
        const [x, y] = [(x0 + x1) / 2, (y0 + y1) / 2];
        picture = { image, name: `${file.name}, ${width} × ${height}`, pixels: width, x, y, scale, opacity: 0.6 };
      } catch {
        this.error = "The browser cannot read this picture; take a PNG or JPEG file.";
      }
    }
    this.desk.refresh();
  }
}

/** m, width and depth on the floor. */
function size({ image, pixels, scale }: Picture): [number, number] {
  return [pixels * scale, (pixels * scale * image.height) / image.width];
}

/** Make a picture larger by a factor; one place stays. */
function stretch(shown: Picture, [x, y]: [number, number], factor: number): void {
  shown.scale *= factor;
  [shown.x, shown.y] = [x + factor * (shown.x - x), y + factor * (shown.y - y)];
}
