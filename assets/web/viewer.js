// The picture: when to sort, when to draw, and at which resolution.

const SETTLES_MS = 150; // after the last motion the picture is drawn at full resolution
const SLOW_MS = 45, QUICK_MS = 22; // frames that lower and raise what a motion shows
const FEWEST = 0.1, COARSEST = 0.4; // shares of the splats and of the resolution
const ALL = -1e9; // threshold of importance

class Viewer {
  constructor(canvas, scene, splats) {
    this.canvas = canvas;
    this.scene = scene;
    this.splats = splats;
    this.renderer = this.makeRenderer();
    const calm = matchMedia("(prefers-reduced-motion: reduce)");
    this.rig = new CameraRig(scene.up, scene.radius, !calm.matches);
    calm.addEventListener("change", () => (this.rig.jumps = !calm.matches));
    this.rig.set(CameraRig.poseOf(scene.start));
    this.hidden = new Uint8Array(scene.objects.length);
    this.selected = new Uint8Array(scene.objects.length);
    this.hovered = 0;
    this.mode = "color";
    this.playing = null; // begin of a film, ms
    this.onFrame = () => {};
    this.motion = { share: 1, fineness: 1 }; // what a motion shows, kept until the next one
    this.fineness = 1;
    this.threshold = ALL; // of what is to be drawn
    this.drawnThreshold = ALL; // of the depth order that is there
    this.ranks = Float32Array.from(splats.importance).sort();
    this.movedAt = -Infinity;
    this.version = 0; // of what is visible
    this.sorted = ""; // what the order was made for
    this.asked = "";
    this.free = new Uint32Array(splats.lines * WIDTH);
    this.worker = sortWorker();
    this.worker.onmessage = (event) => this.take(event.data);
    const { means, reach, labels, importance } = splats;
    this.worker.postMessage({ means, reach, labels, importance });
    this.applyState();
    new ResizeObserver(() => this.invalidate()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.invalidate());
    this.invalidate();
  }

  makeRenderer() {
    const { objects, antialiased } = this.scene;
    const palette = new Float32Array(4 * WIDTH * Math.ceil(objects.length / WIDTH));
    objects.forEach((object, i) => palette.set([...object.color, 1], 4 * i));
    return new Renderer(this.canvas, this.splats, palette, antialiased);
  }

  /** All textures and programs again, after the graphics lost them. */
  restore() {
    this.renderer = this.makeRenderer();
    this.sorted = ""; // the new textures have no order yet
    this.applyState();
  }

  // --- what to show

  /** Draw again soon. */
  invalidate() {
    this.isStale = true;
    delete this.canvas.dataset.settled;
    this.pending ??= requestAnimationFrame((now) => this.frame(now));
  }

  /** Whether the camera moved a moment ago: the picture is not whole. */
  isMoving() {
    return performance.now() - this.movedAt < SETTLES_MS;
  }

  moved() {
    this.movedAt = performance.now();
    this.invalidate();
  }

  /** Show what `hidden` and `selected` say. */
  applyState() {
    this.renderer.setState(this.hidden, this.selected);
    const shown = this.hidden.join("");
    if (shown !== this.shown) this.version++; // another depth order
    this.shown = shown;
    this.invalidate();
  }

  hover(object) {
    if (object === this.hovered) return;
    this.hovered = object;
    this.invalidate();
  }

  play(on) {
    this.playing = on ? performance.now() : null;
    this.rig.way = null;
    this.invalidate();
  }

  /** The camera that looks at the picture in pixels of the page. */
  pageSize() {
    return [Math.max(this.canvas.clientWidth, 1), Math.max(this.canvas.clientHeight, 1)];
  }

  /** Object, splat and place under a point of the canvas, in pixels of the page; null: nothing. */
  pick(x, y) {
    const scale = this.canvas.width / this.pageSize()[0];
    const hit = this.renderer.pick(x * scale, y * scale);
    if (!hit) return null;
    // As deep as the splat is, on the ray of the pointer.
    const { rows } = this.rig.pose, eye = this.rig.eye, [width, height] = this.pageSize();
    const mean = Array.from(this.splats.means.subarray(3 * hit.splat, 3 * hit.splat + 3));
    const depth = dot(plus(mean, eye, -1), rows[2]);
    const focal = this.rig.focal([width, height]);
    const across = [((x - width / 2) / focal) * depth, ((y - height / 2) / focal) * depth];
    const point = plus(plus(plus(eye, rows[2], depth), rows[0], across[0]), rows[1], across[1]);
    return { ...hit, point };
  }

  // --- frames

  frame(now) {
    this.pending = null;
    if (this.renderer.gl.isContextLost()) return; // until `restore`
    if (this.playing !== null) this.playOn(now);
    if (this.rig.update(now)) this.movedAt = now;
    const isMoving = now - this.movedAt < SETTLES_MS;
    this.adapt(now, isMoving);
    this.resize();
    const camera = this.rig.camera([this.canvas.width, this.canvas.height]);
    const key = `${this.version} ${this.threshold} ${camera.matrix} ${camera.lens}`;
    if (key !== this.sorted && this.free) this.sort(camera, key);
    const isDrawn = !this.isStale;
    if (this.isStale && this.sorted) {
      this.isStale = false;
      this.renderer.draw(camera, this.look());
    }
    if (isMoving || this.rig.way || this.playing !== null) this.invalidate();
    else if (isDrawn && key === this.sorted) this.canvas.dataset.settled = "yes";
    else this.pending ??= requestAnimationFrame((later) => this.frame(later));
    this.onFrame();
  }

  playOn(now) {
    const seconds = (now - this.playing) / 1000, { path } = this.scene;
    this.rig.set(poseAt(path, path.closed ? seconds % path.seconds : seconds));
    this.movedAt = now;
    if (!path.closed && seconds >= path.seconds) this.playing = null;
  }

  /** In motion, splats first and then resolution follow the time of a frame; at rest all is shown. */
  adapt(now, isMoving) {
    const took = now - (this.lastFrame ?? now), { motion } = this;
    this.lastFrame = isMoving ? now : undefined;
    if (took > SLOW_MS && motion.share > FEWEST) motion.share = Math.max(motion.share * 0.8, FEWEST);
    else if (took > SLOW_MS) motion.fineness = Math.max(motion.fineness * 0.85, COARSEST);
    else if (took > 0 && took < QUICK_MS && motion.fineness < 1) motion.fineness = Math.min(motion.fineness * 1.05, 1);
    else if (took > 0 && took < QUICK_MS) motion.share = Math.min(motion.share * 1.05, 1);
    this.fineness = isMoving ? motion.fineness : 1;
    const left = isMoving ? Math.floor((1 - motion.share) * this.splats.n) : 0;
    this.threshold = left > 0 ? this.ranks[left] : ALL;
  }

  resize() {
    const scale = Math.min(devicePixelRatio || 1, 2) * this.fineness;
    const [width, height] = this.pageSize().map((side) => Math.max(Math.round(side * scale), 1));
    if (this.canvas.width === width && this.canvas.height === height) return;
    this.canvas.width = width;
    this.canvas.height = height;
    this.isStale = true;
  }

  look() {
    const style = getComputedStyle(document.documentElement).getPropertyValue("--picture");
    return {
      mode: this.mode,
      hovered: this.hovered,
      outlined: this.hovered > 0 || this.selected.some(Boolean),
      background: style.trim().split(/\s+/).map((part) => Number(part) / 255),
      threshold: this.drawnThreshold,
      pixelScale: this.canvas.width / this.pageSize()[0],
    };
  }

  sort(camera, key) {
    this.asked = key;
    const { lens, size } = camera, order = this.free;
    this.free = null;
    const view = camera.matrix.slice(0, 12);
    const { hidden, threshold } = this;
    this.worker.postMessage({ ticket: key, view, lens, size, hidden, threshold, order }, [order.buffer]);
  }

  take({ ticket, threshold, order, count }) {
    this.renderer.setOrder(order, count);
    // The renderer keeps this order for picking; the next one is written to the former one's room.
    this.free = this.kept ?? new Uint32Array(order.length);
    this.kept = order;
    this.sorted = ticket;
    this.drawnThreshold = threshold;
    this.invalidate();
  }
}

function sortWorker() {
  const address = URL.createObjectURL(new Blob([SORT_WORKER], { type: "text/javascript" }));
  const worker = new Worker(address);
  worker.onerror = () => fail(new PageError("The browser refuses to sort the splats in a worker."));
  return worker;
}
