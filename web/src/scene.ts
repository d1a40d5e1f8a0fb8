// The 3-D view of an episode, from behind the robot: boxes, people who walk, the robot, its goal and its path.

import {
  BoxGeometry,
  BufferGeometry,
  CapsuleGeometry,
  CircleGeometry,
  Color,
  CylinderGeometry,
  DirectionalLight,
  Float32BufferAttribute,
  Fog,
  Group,
  HemisphereLight,
  InstancedMesh,
  LineBasicMaterial,
  LineSegments,
  type Material,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  PerspectiveCamera,
  PlaneGeometry,
  RingGeometry,
  Scene as Space,
  SphereGeometry,
  Vector3,
  WebGLRenderer,
} from "three";
import { palette, type Palette } from "./palette";
import { stateOf } from "./state";
import { add } from "./player";
import type { Episode, Recording } from "./recording";
import { toBox } from "./sight";

const TALL = 1.7; // m, a person
const LEG = 0.8; // m, up to the hips
const STRIDE = 1.4; // m, of two steps
const SWING = 0.55; // rad, of a leg at WALK and faster
const WALK = 1.3; // m/s
const LEAP = 1; // m between two pictures, above which a person has not walked
const BEHIND = [0, 0.4, 4.2]; // rad to the left, rad above, m from the robot
const AIM = 0.6; // m above the floor, where the camera looks
const PART = 4; // m, of a line of the floor: drawing by software loses those that begin behind the camera
const DOTS = 64; // of the path, at most

/** Whether the browser draws in 3-D, by a graphics card or by software, which is slow. */
export function graphics(): "card" | "software" | null {
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) return null;
  const detail = context.getExtension("WEBGL_debug_renderer_info");
  const name = String(context.getParameter(detail ? detail.UNMASKED_RENDERER_WEBGL : context.RENDERER));
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name) ? "software" : "card";
}

/** A geometry that stands up: three.js has its axis along y. */
function upright<Shape extends BufferGeometry>(shape: Shape, height: number): Shape {
  shape.rotateX(Math.PI / 2);
  shape.translate(0, 0, height);
  return shape;
}

export class Scene {
  private readonly canvas: HTMLCanvasElement;
  private readonly renderer: WebGLRenderer;
  private readonly space = new Space();
  private readonly camera = new PerspectiveCamera(55, 1, 0.1, 400);
  private orbit = [...BEHIND];
  private readonly solid: InstancedMesh;
  private readonly glass: InstancedMesh; // boxes between the camera and the robot
  private readonly people: InstancedMesh[]; // bodies, heads, legs on the left, legs on the right, shadows
  private readonly robot: Group | null = null;
  private readonly goal = new Group();
  private readonly path: InstancedMesh;
  private readonly tints: { material: Material & { color: Color }; name: Tint }[] = [];
  private readonly finest: number; // pixels of the screen in one of the page, at most
  private readonly count: number;
  private readonly phase: number[]; // rad, of a person's steps
  private readonly place: [number, number][]; // m, of people at the latest picture
  private readonly observer: ResizeObserver;
  private latest: [Episode, number] | null = null;
  private pending = false;
  private colors!: Palette;
  private between = ""; // numbers of the boxes of glass

  constructor(
    place: HTMLElement,
    private readonly recording: Recording,
    people: number,
    smooth: boolean,
  ) {
    this.canvas = add(place, "canvas", "studio-scene");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "the episode in 3-D, from behind the robot");
    this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: smooth });
    this.finest = smooth ? 2 : 1;
    this.camera.up.set(0, 0, 1);
    this.count = people;
    this.phase = Array.from({ length: people }, (_, k) => 2.4 * k); // out of step
    this.place = this.phase.map(() => [0, 0]);
    this.space.add(new HemisphereLight(0xffffff, 0x8890a0, 2.2));
    const sun = new DirectionalLight(0xffffff, 1.4);
    sun.position.set(-3, -5, 9);
    this.space.add(sun);
    this.addFloor();
    const box = new BoxGeometry(1, 1, 1);
    const boxes = Math.max(1, recording.place.obstacles.length);
    this.solid = this.instances(box, this.lambert(null), boxes);
    this.glass = this.instances(box, this.lambert(null, 0.16), boxes);
    const radius = recording.person.radius;
    const [torso, leg] = [TALL - LEG - 0.3, 0.075];
    const shape = upright(new CapsuleGeometry(radius, torso - radius, 2, 8), LEG + torso / 2);
    shape.scale(0.75, 1.05, 1); // less deep than wide
    this.people = [
      this.instances(shape, this.lambert(null), people),
      this.instances(new SphereGeometry(0.125, 8, 6).translate(0.03, 0, TALL - 0.12), this.lambert("ink"), people),
      ...[1, -1].map((side) =>
        // from the hip down
        this.instances(
          upright(new CylinderGeometry(leg, leg, LEG, 6), -LEG / 2).translate(0, 0.5 * radius * side, 0),
          this.lambert("obstacle"),
          people,
        ),
      ),
      this.instances(new CircleGeometry(1.4 * radius, 10), this.shade(), people),
    ];
    if (recording.robot) this.robot = this.addRobot(recording.robot.radius);
    this.path = this.instances(new CircleGeometry(0.07, 10), this.plain("robot"), DOTS);
    const ring = new Mesh(new RingGeometry(0.4, 0.5, 32).translate(0, 0, 0.02), this.plain("robot"));
    const beam = new Mesh(upright(new CylinderGeometry(0.04, 0.04, 2.5, 8), 1.25), this.plain("robot", 0.5));
    this.goal.add(ring, beam);
    this.space.add(this.goal);
    this.goal.visible = recording.robot !== null;
    this.listen();
    this.paint();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", this.paint);
    this.observer = new ResizeObserver(() => this.request());
    this.observer.observe(this.canvas);
  }

  /** Remove the view, and free its memory. */
  close(): void {
    this.observer.disconnect();
    matchMedia("(prefers-color-scheme: dark)").removeEventListener("change", this.paint);
    this.space.traverse((part) => {
      if (part instanceof Mesh || part instanceof LineSegments) part.geometry.dispose();
      if (part instanceof InstancedMesh) part.dispose();
    });
    this.latest = null;
    this.renderer.dispose();
    this.renderer.forceContextLoss();
    this.canvas.remove();
  }

  /** Draw a moment [s] of an episode. */
  draw(episode: Episode, time: number): void {
    this.latest = [episode, time];
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!width || !height) return;
    const fine = Math.min(this.finest, window.devicePixelRatio || 1);
    if (this.canvas.width !== Math.floor(width * fine) || this.canvas.height !== Math.floor(height * fine)) {
      this.renderer.setPixelRatio(fine);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
    }
    const frame = episode.frameAt(time);
    const value = (name: string): number => episode.at(episode.of(name)[0], time);
    let [x, y, heading] = [0, 0, 0];
    if (this.robot) {
      [x, y, heading] = [value("robot x"), value("robot y"), episode.angleAt(episode.of("robot heading")[0], time)];
      this.robot.position.set(x, y, 0);
      this.robot.rotation.z = heading;
      this.goal.position.set(episode.of("goal x")[0][frame], episode.of("goal y")[0][frame], 0);
      this.drawPath(episode, frame);
    }
    this.aim(x, y, heading);
    this.drawPeople(episode, time);
    this.renderer.render(this.space, this.camera);
    this.canvas.dataset.pictures = String(this.renderer.info.render.frame);
  }

  private addFloor(): void {
    const [x0, y0, x1, y1] = this.recording.place.floor;
    const floor = new Mesh(new PlaneGeometry(x1 - x0, y1 - y0), this.plain("floor"));
    floor.position.set((x0 + x1) / 2, (y0 + y1) / 2, -0.02);
    const points: number[] = [];
    for (let x = Math.ceil(x0); x <= x1; x++) {
      for (let y = y0; y < y1; y += PART) points.push(x, y, -0.01, x, Math.min(y1, y + PART), -0.01);
    }
    for (let y = Math.ceil(y0); y <= y1; y++) {
      for (let x = x0; x < x1; x += PART) points.push(x, y, -0.01, Math.min(x1, x + PART), y, -0.01);
    }
    const lines = new BufferGeometry();
    lines.setAttribute("position", new Float32BufferAttribute(points, 3));
    const material = new LineBasicMaterial();
    this.tints.push({ material, name: "line" });
    this.space.add(floor, new LineSegments(lines, material));
  }

  private addRobot(radius: number): Group {
    const group = new Group();
    const high = 2 * radius; // a recording has no height
    const body = new Mesh(upright(new CylinderGeometry(radius, radius, high, 24), high / 2), this.lambert("robot"));
    const mark = new Mesh(new BoxGeometry(1.1 * radius, 0.25 * radius, 0.05), this.lambert("robot-edge"));
    mark.position.set(0.55 * radius, 0, high + 0.02);
    const shadow = new Mesh(new CircleGeometry(1.25 * radius, 24).translate(0, 0, 0.005), this.shade());
    group.add(body, mark, shadow);
    this.space.add(group);
    return group;
  }

  private instances(shape: BufferGeometry, material: Material, count: number): InstancedMesh {
    const made = new InstancedMesh(shape, material, Math.max(1, count));
    made.frustumCulled = false; // they are everywhere
    made.count = 0;
    this.space.add(made);
    return made;
  }

  private lambert(name: Tint | null, opacity = 1): MeshLambertMaterial {
    const material = new MeshLambertMaterial({ transparent: opacity < 1, opacity, depthWrite: opacity === 1 });
    if (name) this.tints.push({ material, name });
    return material;
  }

  private plain(name: Tint, opacity = 1): MeshBasicMaterial {
    const material = new MeshBasicMaterial({ transparent: opacity < 1, opacity });
    this.tints.push({ material, name });
    return material;
  }

  private shade(): MeshBasicMaterial {
    return new MeshBasicMaterial({ color: 0, transparent: true, opacity: 0.22, depthWrite: false });
  }

  /** The colors of the page, light or dark. */
  private readonly paint = (): void => {
    const colors = (this.colors = palette(this.canvas));
    for (const { material, name } of this.tints) material.color.set(colors[name]);
    this.space.background = new Color(colors.paper);
    this.space.fog = new Fog(colors.paper, 15, 90);
    this.between = "none yet";
    this.request();
  };

  private request(): void {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      if (this.latest) this.draw(...this.latest);
    });
  }

  private drawPath(episode: Episode, frame: number): void {
    const [xs, ys] = [episode.of("plan x"), episode.of("plan y")];
    this.path.count = Math.min(DOTS, xs.length);
    for (let k = 0; k < this.path.count; k++) this.path.setMatrixAt(k, MATRIX.makeTranslation(xs[k][frame], ys[k][frame], 0.01));
    this.path.instanceMatrix.needsUpdate = true;
  }

  private drawPeople(episode: Episode, time: number): void {
    const [person, member, yielding] = (["person", "member", "yielding"] as const).map((name) => new Color(this.colors[name]));
    const colors = { person, member, yielding };
    const frame = episode.frameAt(time);
    const before = Math.max(0, frame - 1);
    const [xs, ys, headings] = ["person x", "person y", "person heading"].map((name) => episode.of(name));
    const present = episode.of("person present");
    const [eye, ahead] = [this.camera.position, this.camera.getWorldDirection(new Vector3())];
    let k = 0;
    for (let n = 0; n < Math.min(this.count, xs.length); n++) {
      if (present[n][frame] < 0.5) continue;
      const stays = present[n][Math.min(frame + 1, episode.frames - 1)] > 0.5;
      const [x, y] = stays ? [episode.at(xs[n], time), episode.at(ys[n], time)] : [xs[n][frame], ys[n][frame]];
      const way = Math.hypot(x - this.place[n][0], y - this.place[n][1]);
      if (way < LEAP) this.phase[n] += (2 * Math.PI * way) / STRIDE;
      this.place[n] = [x, y];
      if ((x - eye.x) * ahead.x + (y - eye.y) * ahead.y < eye.z * ahead.z - 1) continue; // behind the camera
      const speed = Math.hypot(xs[n][frame] - xs[n][before], ys[n][frame] - ys[n][before]) / episode.timeStep;
      const swing = SWING * Math.min(1, speed / WALK) * Math.sin(this.phase[n]);
      const stand = MATRIX.makeRotationZ(episode.angleAt(headings[n], time)).setPosition(x, y, 0);
      const [body, head, left, right, shadow] = this.people;
      body.setMatrixAt(k, stand);
      head.setMatrixAt(k, stand);
      shadow.setMatrixAt(k, stand);
      left.setMatrixAt(k, OTHER.makeRotationY(swing).setPosition(0, 0, LEG).premultiply(stand));
      right.setMatrixAt(k, OTHER.makeRotationY(-swing).setPosition(0, 0, LEG).premultiply(stand));
      body.setColorAt(k, colors[stateOf(episode, n, frame)]);
      k++;
    }
    for (const mesh of this.people) {
      mesh.count = k;
      mesh.instanceMatrix.needsUpdate = true;
      if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
    }
  }

  /** Place the camera; boxes that hide the robot or what is near it become glass. */
  private aim(x: number, y: number, heading: number): void {
    const [left, above, far] = this.orbit;
    const angle = heading + Math.PI + left;
    const [across, up] = [far * Math.cos(above), far * Math.sin(above)];
    const [dx, dy] = [Math.cos(angle), Math.sin(angle)];
    this.camera.position.set(x + across * dx, y + across * dy, AIM + up);
    this.camera.lookAt(new Vector3(x, y, AIM));
    const eye = this.camera.position;
    const near = [[x, y], [x - dy, y + dx], [x + dy, y - dx], [x - dx, y - dy]]; // the robot, 1 m beside and beyond it
    const hidden = this.recording.place.obstacles.map((box) =>
      near.some(([fromX, fromY]) => {
        const way = Math.hypot(eye.x - fromX, eye.y - fromY);
        const reach = toBox(box, fromX, fromY, (eye.x - fromX) / way, (eye.y - fromY) / way);
        return reach < way && AIM + (up * reach) / way < box[5];
      }),
    );
    const key = hidden.join();
    if (key === this.between) return;
    this.between = key;
    const [low, high, color] = [new Color(this.colors.floor), new Color(this.colors.obstacle), new Color()];
    const counts = [0, 0];
    this.recording.place.obstacles.forEach(([cx, cy, hx, hy, yaw, height], k) => {
      if (height <= 0) return;
      const mesh = hidden[k] ? this.glass : this.solid;
      const index = counts[Number(hidden[k])]++;
      MATRIX.makeRotationZ(yaw).scale(new Vector3(2 * hx, 2 * hy, height)).setPosition(cx, cy, height / 2);
      mesh.setMatrixAt(index, MATRIX);
      mesh.setColorAt(index, color.lerpColors(low, high, 0.4 + 0.4 * Math.min(1, height / 4)));
    });
    [this.solid, this.glass].forEach((mesh, k) => {
      mesh.count = counts[k];
      mesh.instanceMatrix.needsUpdate = true;
      if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
    });
  }

  /** Drag turns the camera, the wheel moves it nearer, a double click puts it behind the robot. */
  private listen(): void {
    const { canvas } = this;
    canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
    canvas.onpointermove = (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      this.orbit[0] -= 0.008 * event.movementX;
      this.orbit[1] = Math.max(0.05, Math.min(1.5, this.orbit[1] + 0.006 * event.movementY));
      this.request();
    };
    canvas.onwheel = (event) => {
      if (document.activeElement !== canvas) return; // the page scrolls
      event.preventDefault();
      this.orbit[2] = Math.max(1.5, Math.min(60, this.orbit[2] * Math.exp(0.0015 * event.deltaY)));
      this.request();
    };
    canvas.ondblclick = () => {
      this.orbit = [...BEHIND];
      this.request();
    };
  }
}

type Tint = "floor" | "line" | "ink" | "obstacle" | "robot" | "robot-edge";
const [MATRIX, OTHER] = [new Matrix4(), new Matrix4()];
