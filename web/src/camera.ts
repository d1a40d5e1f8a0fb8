// Where the plan is on the screen: zoom and place, moved by wheel, drag and pinch.

export class Camera {
  private zoom = 1; // 1: the whole floor
  private center: [number, number];

  constructor(
    private readonly floor: [number, number, number, number],
    private width = 1,
    private height = 1,
  ) {
    this.center = [(floor[0] + floor[2]) / 2, (floor[1] + floor[3]) / 2];
  }

  /** Pixels in a metre. */
  get scale(): number {
    const [x0, y0, x1, y1] = this.floor;
    return this.zoom * 0.96 * Math.min(this.width / (x1 - x0), this.height / (y1 - y0));
  }

  resize(width: number, height: number): void {
    [this.width, this.height] = [width, height];
  }

  reset(): void {
    this.zoom = 1;
    this.center = [(this.floor[0] + this.floor[2]) / 2, (this.floor[1] + this.floor[3]) / 2];
  }

  /** Look at a place [m], no nearer than it is already. */
  follow(x: number, y: number): void {
    this.zoom = Math.max(this.zoom, 2.2);
    this.center = [x, y];
  }

  toScreen(x: number, y: number): [number, number] {
    return [this.width / 2 + (x - this.center[0]) * this.scale, this.height / 2 - (y - this.center[1]) * this.scale];
  }

  toPlan(px: number, py: number): [number, number] {
    return [
      this.center[0] + (px - this.width / 2) / this.scale,
      this.center[1] - (py - this.height / 2) / this.scale,
    ];
  }

  pan(dx: number, dy: number): void {
    this.center = [this.center[0] - dx / this.scale, this.center[1] + dy / this.scale];
  }

  /** Zoom by a factor; what is below that pixel stays there. */
  zoomAt(px: number, py: number, factor: number): void {
    const [x, y] = this.toPlan(px, py);
    this.zoom = Math.max(0.5, Math.min(30, this.zoom * factor));
    const [now, then] = [this.toScreen(x, y), [px, py]];
    this.pan(then[0] - now[0], then[1] - now[1]);
  }

  /** Listen to wheel, drag, pinch and double click. `moved(byHand)` is called after each change. */
  listen(element: HTMLElement, moved: () => void): void {
    const fingers = new Map<number, [number, number]>();
    const place = (event: MouseEvent): [number, number] => {
      const box = element.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    element.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey && !event.metaKey && document.activeElement !== element) return; // the page scrolls
        event.preventDefault();
        this.zoomAt(...place(event), Math.exp(-0.0015 * event.deltaY));
        moved();
      },
      { passive: false },
    );
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, place(event));
    });
    element.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const now = place(event);
      const other = [...fingers].find(([id]) => id !== event.pointerId)?.[1];
      if (other) {
        const apart = (point: [number, number]) => Math.hypot(point[0] - other[0], point[1] - other[1]);
        this.zoomAt((now[0] + other[0]) / 2, (now[1] + other[1]) / 2, apart(now) / Math.max(1, apart(before)));
      } else {
        this.pan(now[0] - before[0], now[1] - before[1]);
      }
      fingers.set(event.pointerId, now);
      moved();
    });
    for (const kind of ["pointerup", "pointercancel"] as const) {
      element.addEventListener(kind, (event) => fingers.delete(event.pointerId));
    }
    element.addEventListener("dblclick", () => {
      this.reset();
      moved();
    });
  }
}
