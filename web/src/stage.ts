/** The rig and the bodies in 3D: orbit with mouse or keys, click a camera to choose it. */
import { Color, ColorManagement, Group, LinearSRGBColorSpace, LineBasicMaterial, LineSegments, BufferGeometry, Float32BufferAttribute, PerspectiveCamera, Quaternion, Scene, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { BodyModel } from "./body_model";
import { h } from "./dom";
import { drawLabels, type Label } from "./labels";
import { ofIndividual } from "./palette";
import type { Player } from "./player";
import { middleOf, type Recording } from "./recording";
import { niceStep } from "./charts";
import { RigModel, standsAt, type RigOptions } from "./rig_model";
import { colour, onTheme } from "./theme";

// colours are those of the style, as they are
ColorManagement.enabled = false;

const SLOW_MS = 36;
/** More cameras or individuals are drawn with less detail by a processor. */
const MANY = 12;
const KEYS: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export interface StageOptions extends RigOptions {
  trails: boolean;
  names: boolean;
}

export class Stage {
  readonly canvas = h("canvas", { class: "gl", tabindex: 0, role: "application" });
  private readonly overlay = h("canvas", { class: "labels", "aria-hidden": "true" });
  readonly host = h("div", { class: "stage" }, this.canvas, this.overlay);
  readonly options: StageOptions = { trails: true, names: true, ellipsoids: true, reference: true, detail: true };
  readonly rig: RigModel;
  private readonly bodies: BodyModel;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly root = new Group();
  private readonly view = new PerspectiveCamera(40, 1, 0.01, 1000);
  private readonly controls: OrbitControls;
  private grid: LineSegments | null = null;
  private home = new Vector3();
  private ratios: number[];
  private pending = false;
  private lastDrawn = 0;
  /** Whether cameras stand elsewhere later. */
  private readonly moves: boolean;
  private slow: number[] = [];
  private readonly at = new Vector3();

  /** Throws where the browser has no WebGL. */
  constructor(private readonly recording: Recording, private readonly player: Player) {
    const software = isSoftware();
    const ratio = software ? 1 : Math.min(devicePixelRatio || 1, 2);
    const { cameras, individuals } = recording;
    this.options.detail = !(software && (cameras.length > MANY || individuals.length > MANY));
    this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: !software, powerPreference: "high-performance" });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.ratios = [ratio, 1, 0.75, 0.5].filter((each, i) => i === 0 || each < ratio);
    this.view.up.set(0, 0, 1);
    this.moves = recording.cameras.some((camera) => camera.first > recording.frames[0]!);
    this.rig = new RigModel(recording);
    this.bodies = new BodyModel(recording);
    this.root.add(this.rig.group, this.bodies.group);
    this.root.quaternion.copy(new Quaternion().setFromUnitVectors(new Vector3(...recording.up), new Vector3(0, 0, 1)));
    this.scene.add(this.root);
    this.controls = new OrbitControls(this.view, this.canvas);
    this.controls.enableZoom = false;
    this.frameAll();
    this.drawGrid();
    this.listen();
    this.describe();
  }

  private listen(): void {
    this.controls.addEventListener("change", () => this.request());
    // the wheel scrolls the page until the view is chosen
    this.canvas.addEventListener("focus", () => (this.controls.enableZoom = true));
    this.canvas.addEventListener("blur", () => (this.controls.enableZoom = false));
    this.canvas.addEventListener("pointerdown", () => this.canvas.focus({ preventScroll: true }));
    this.canvas.addEventListener("click", (event) => this.pick(event));
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.resize()).observe(this.host);
    this.player.on((change) => {
      if (change === "camera" || (change === "frame" && this.moves)) this.refreshRig();
      if (change !== "playing") this.request();
      else this.slow = [];
    });
    onTheme(() => this.refresh());
  }

  /** Draw everything anew: options or colours have changed. */
  refresh(): void {
    this.drawGrid();
    this.refreshRig();
    this.request();
  }

  private refreshRig(): void {
    this.rig.update(this.player.camera, this.frame, this.options);
    this.describe();
  }

  private get frame(): number {
    return this.recording.frames[this.player.index] ?? 0;
  }

  private describe(): void {
    const { cameras, individuals } = this.recording;
    this.canvas.setAttribute("aria-label",
      `The rig in 3D: ${cameras.length} cameras and ${individuals.length} individuals. Drag or Shift with arrow keys turns it, `
      + `plus and minus zoom, space plays, arrow keys step. Chosen camera: ${cameras[this.player.camera]?.name ?? "none"}.`);
  }

  /** Put everything into view. */
  frameAll(): void {
    this.root.updateMatrixWorld(true);
    const toWorld = (point: readonly number[]): Vector3 => this.root.localToWorld(new Vector3(point[0], point[1], point[2]));
    const cameras = this.recording.centres.map(toWorld);
    const all = [...cameras, ...usualCorners(this.someMiddles().map(toWorld))];
    const low = all.reduce((least, point) => least.min(point), all[0]!.clone());
    const high = all.reduce((most, point) => most.max(point), all[0]!.clone());
    const target = low.add(high).multiplyScalar(0.5);
    const back = new Vector3(0.62, -0.72, 0.5).normalize();
    const right = new Vector3().crossVectors(this.view.up, back).normalize();
    const above = new Vector3().crossVectors(back, right);
    const tall = Math.tan((this.view.fov * Math.PI) / 360);
    // the nearest place from which every point is within the margins
    const distance = Math.max(4 * this.rig.size, ...all.map((point) => {
      const offset = point.clone().sub(target);
      const x = Math.abs(offset.dot(right)) + 0.7 * this.rig.size;
      const y = Math.abs(offset.dot(above)) + 0.7 * this.rig.size;
      return offset.dot(back) + Math.max(x / (0.92 * tall * this.view.aspect), y / (0.88 * tall));
    }));
    this.home = target;
    this.view.position.copy(target).addScaledVector(back, distance);
    this.view.near = distance / 500;
    this.view.far = distance * 20;
    this.view.updateProjectionMatrix();
    this.controls.target.copy(target);
    this.controls.update();
    this.request();
  }

  private someMiddles(): [number, number, number][] {
    const step = Math.max(1, Math.floor(this.recording.frames.length / 40));
    const found: [number, number, number][] = [];
    this.recording.individuals.forEach((_, individual) => {
      for (let frame = 0; frame < this.recording.frames.length; frame += step) {
        const middle = middleOf(this.recording, individual, frame);
        if (middle) found.push(middle);
      }
    });
    return found;
  }

  /** Draw a grid on the floor; where no floor is known, none. */
  private drawGrid(): void {
    if (this.grid) this.scene.remove(this.grid);
    const { floor } = this.recording;
    if (!floor) return;
    const middle = this.root.localToWorld(new Vector3(...floor)).z;
    const target = this.home;
    const cell = niceStep(1e6 * this.rig.size) / 1e6;
    const half = 14 * cell;
    const origin = [Math.round(target.x / cell) * cell, Math.round(target.y / cell) * cell] as const;
    const places: number[] = [];
    for (let at = -half; at <= half + cell / 2; at += cell) {
      places.push(origin[0] + at, origin[1] - half, middle, origin[0] + at, origin[1] + half, middle);
      places.push(origin[0] - half, origin[1] + at, middle, origin[0] + half, origin[1] + at, middle);
    }
    const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(places, 3));
    this.grid = new LineSegments(geometry, new LineBasicMaterial({ color: new Color(colour("grid")) }));
    this.scene.add(this.grid);
  }

  private key(event: KeyboardEvent): void {
    const turn = event.shiftKey ? KEYS[event.key] : undefined;
    const zoom = { "+": 0.85, "=": 0.85, "-": 1.18 }[event.key];
    if (!turn && !zoom) return;
    event.preventDefault();
    event.stopPropagation();
    const offset = this.view.position.clone().sub(this.controls.target);
    if (turn) {
      offset.applyAxisAngle(this.view.up, -0.12 * turn[0]);
      const across = new Vector3().crossVectors(this.view.up, offset).normalize();
      const turned = offset.clone().applyAxisAngle(across, 0.12 * turn[1]);
      if (Math.abs(turned.clone().normalize().z) < 0.99) offset.copy(turned);
    }
    this.view.position.copy(this.controls.target).addScaledVector(offset, zoom ?? 1);
    this.controls.update();
    this.request();
  }

  /** Choose the camera that was clicked: the nearest within a finger's width. */
  private pick(event: MouseEvent): void {
    const box = this.canvas.getBoundingClientRect();
    let best = 28;
    let found = -1;
    this.recording.centres.forEach((centre, view) => {
      const [x, y, depth] = this.screen(centre);
      const away = Math.hypot(x - (event.clientX - box.left), y - (event.clientY - box.top));
      if (depth < 1 && away < best) [best, found] = [away, view];
    });
    if (found >= 0) this.player.choose("camera", found);
  }

  /** Return where a point of the world is on the canvas, in CSS pixels, and its depth. */
  private screen(point: readonly number[]): [number, number, number] {
    this.root.localToWorld(this.at.set(point[0]!, point[1]!, point[2]!)).project(this.view);
    const { clientWidth: width, clientHeight: height } = this.host;
    return [((this.at.x + 1) / 2) * width, ((1 - this.at.y) / 2) * height, this.at.z];
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (!width || !height) return;
    this.renderer.setPixelRatio(this.ratios[0]!);
    this.renderer.setSize(width, height, false);
    const first = this.view.aspect === 1;
    this.view.aspect = width / height;
    this.view.updateProjectionMatrix();
    if (first) this.frameAll();
    this.refresh();
  }

  private request(): void {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame((now) => this.draw(now));
  }

  private draw(now: number): void {
    this.pending = false;
    if (this.player.playing) this.adapt(now - this.lastDrawn);
    this.lastDrawn = now;
    const { player } = this;
    if (player.follow >= 0) this.moveTo(middleOf(this.recording, player.follow, player.index));
    this.bodies.update(player.index, { ...this.options, follow: player.follow });
    this.renderer.setClearColor(new Color(colour("stage")));
    this.renderer.render(this.scene, this.view);
    this.drawLabels();
    this.canvas.dataset.drawn = String(Number(this.canvas.dataset.drawn ?? 0) + 1);
  }

  private moveTo(middle: [number, number, number] | null): void {
    if (!middle) return;
    const to = this.root.localToWorld(new Vector3(...middle));
    this.view.position.add(to.clone().sub(this.controls.target));
    this.controls.target.copy(to);
    this.view.lookAt(to);
    this.view.updateMatrixWorld();
  }

  /** Lower the detail where drawing takes too long: thin lines first, then fewer pixels. */
  private adapt(milliseconds: number): void {
    this.slow.push(milliseconds);
    if (this.slow.length < 12) return;
    const usual = this.slow.slice(2).reduce((sum, each) => sum + each, 0) / (this.slow.length - 2);
    this.slow = [];
    if (usual < SLOW_MS) return;
    if (this.options.detail) {
      this.options.detail = false;
      this.refreshRig();
    } else if (this.ratios.length > 1) {
      this.ratios.shift();
      this.resize();
    }
  }

  private drawLabels(): void {
    const labels: Label[] = [];
    if (this.options.names) {
      this.recording.cameras.forEach((camera, view) => {
        if (!standsAt(camera, this.frame)) return;
        const [x, y, depth] = this.screen(this.recording.centres[view]!);
        labels.push({ x, y: y - 10, depth, text: camera.name, colour: colour(view === this.player.camera ? "accent" : "ink"), first: view === this.player.camera });
      });
    }
    this.recording.individuals.forEach((name, index) => {
      const middle = middleOf(this.recording, index, this.player.index);
      if (!middle) return;
      const [x, y, depth] = this.screen(middle);
      labels.push({ x, y, depth, text: String(name), colour: ofIndividual(index), first: true, badge: true });
    });
    drawLabels(this.overlay, labels);
  }
}

/** Return the corners of the box that most points are in: some are far away, by mistake. */
function usualCorners(points: Vector3[]): Vector3[] {
  if (!points.length) return [];
  const at = (share: number, axis: "x" | "y" | "z"): number => {
    const sorted = points.map((point) => point[axis]).sort((a, b) => a - b);
    return sorted[Math.floor(share * (sorted.length - 1))]!;
  };
  return [0.1, 0.9].flatMap((x) => [0.1, 0.9].flatMap((y) => [0.1, 0.9].map((z) => new Vector3(at(x, "x"), at(y, "y"), at(z, "z")))));
}

/** Return whether WebGL is made by the processor. */
function isSoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = gl && info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}
