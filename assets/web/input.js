// Mouse, fingers and keys over the picture.

const CLICK_PX = 6; // a drag is longer
const DOUBLE_MS = 350;

class Pointers {
  constructor(viewer, panel) {
    this.viewer = viewer;
    this.panel = panel;
    this.canvas = viewer.canvas;
    this.down = new Map(); // pointers that press: id to place
    this.start = null; // of what may become a click
    this.grip = null; // pose and fingers when the second one came down
    this.lastTap = null;
    const on = (name, act) => this.canvas.addEventListener(name, act.bind(this), { passive: false });
    on("pointerdown", this.press);
    on("pointermove", this.move);
    on("pointerup", this.lift);
    on("pointercancel", this.forget);
    on("pointerleave", this.leave);
    on("wheel", this.wheel);
    on("contextmenu", (event) => event.preventDefault());
    viewer.onFrame = () => this.rest();
  }

  place(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  press(event) {
    this.canvas.focus({ preventScroll: true, focusVisible: false });
    this.canvas.setPointerCapture(event.pointerId);
    this.viewer.playing = null;
    this.down.set(event.pointerId, this.place(event));
    this.start = this.down.size === 1 && event.button === 0 ? this.place(event) : null;
    this.grip = this.down.size === 2 ? { pose: this.viewer.rig.pose, places: [...this.down.values()] } : null;
    this.slides = event.button > 0 || event.shiftKey;
    this.over = null;
  }

  move(event) {
    const at = this.place(event), before = this.down.get(event.pointerId);
    if (!before) {
      this.over = event.pointerType === "mouse" ? at : null; // asked once the picture rests
      this.viewer.pending ??= requestAnimationFrame((now) => this.viewer.frame(now));
      return;
    }
    if (this.start && Math.hypot(at[0] - this.start[0], at[1] - this.start[1]) < CLICK_PX) return;
    if (this.start) this.down.set(event.pointerId, at);
    const isFirst = this.start !== null;
    this.start = null;
    if (isFirst) {
      this.leave(); // nothing is pointed at while the picture moves
      return;
    }
    this.down.set(event.pointerId, at);
    if (this.grip) this.pinch();
    else if (this.down.size === 1) this.drag(at[0] - before[0], at[1] - before[1]);
    this.viewer.moved();
  }

  drag(dx, dy) {
    const [width, height] = this.viewer.pageSize();
    if (this.slides) this.viewer.rig.pan(dx, dy, [width, height]);
    else this.viewer.rig.orbit(dx / height, dy / height);
  }

  /** Two fingers: their middle moves the picture, their distance zooms, from where they came down. */
  pinch() {
    const { pose, places } = this.grip;
    const [a, b] = places, [c, d] = [...this.down.values()];
    const far = (p, q) => Math.max(Math.hypot(p[0] - q[0], p[1] - q[1]), 1);
    this.viewer.rig.set(pose);
    this.viewer.rig.pan((c[0] + d[0] - a[0] - b[0]) / 2, (c[1] + d[1] - a[1] - b[1]) / 2, this.viewer.pageSize());
    this.viewer.rig.zoom(far(a, b) / far(c, d));
  }

  lift(event) {
    const isClick = this.start !== null && this.down.has(event.pointerId);
    this.forget(event);
    if (isClick) this.click(this.place(event));
  }

  forget(event) {
    this.down.delete(event.pointerId);
    this.start = null;
    this.grip = null;
  }

  leave() {
    this.over = null;
    byId("tip").hidden = true;
    this.viewer.hover(0);
  }

  click(at) {
    const now = performance.now(), last = this.lastTap;
    const hit = this.viewer.pick(...at);
    const isDouble = last && now - last.time < DOUBLE_MS && Math.hypot(at[0] - last.at[0], at[1] - last.at[1]) < 20;
    this.lastTap = isDouble ? null : { time: now, at };
    if (isDouble && hit) {
      this.viewer.rig.lookAt(hit.point);
      this.viewer.moved();
    } else if (!isDouble) {
      this.panel.select(hit?.object ?? 0);
    }
  }

  wheel(event) {
    event.preventDefault();
    this.viewer.playing = null;
    // A pinch on a touchpad comes as a wheel with Ctrl, in small steps.
    const pixels = event.deltaY * [1, 16, 400][event.deltaMode] * (event.ctrlKey ? 6 : 1);
    this.viewer.rig.zoom(Math.exp(0.0015 * Math.max(-400, Math.min(400, pixels))));
    this.viewer.moved();
  }

  /** Name what is under the mouse, once the picture is whole. */
  rest() {
    if (!this.over || !this.canvas.dataset.settled && this.viewer.isMoving()) return;
    const at = this.over;
    this.over = null;
    const object = this.viewer.pick(...at)?.object ?? 0;
    this.viewer.hover(object);
    const tip = byId("tip");
    tip.hidden = object === 0;
    if (object === 0) return;
    tip.textContent = this.viewer.scene.objects[object].name;
    const [width, height] = this.viewer.pageSize();
    tip.style.left = `${Math.min(at[0] + 14, Math.max(width - tip.offsetWidth - 4, 0))}px`;
    tip.style.top = `${Math.min(at[1] + 18, height - tip.offsetHeight - 4)}px`;
  }
}

/** Keys of the page; in a field or on a button only those that it does not need itself. */
function listenToKeys(viewer, panel, acts) {
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const isField = event.target instanceof HTMLInputElement;
    if (event.key === "Escape") {
      if (isField && event.target.value) {
        event.target.value = "";
        panel.filter();
      } else panel.select(0);
      return;
    }
    if (isField) return;
    const act = keyActs(viewer, panel, acts, event);
    if (!act) return;
    event.preventDefault();
    act();
  });
}

function keyActs(viewer, panel, acts, event) {
  const { current } = panel, { rig } = viewer;
  const now = (change) => () => {
    viewer.playing = null;
    change();
    viewer.moved();
  };
  const turns = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  const [x, y] = turns[event.key] ?? [0, 0];
  if ((x || y) && event.target === viewer.canvas) {
    return event.shiftKey ? now(() => rig.pan(24 * x, 24 * y, viewer.pageSize())) : now(() => rig.orbit(x / 36, y / 36));
  }
  const selected = current > 0;
  const table = {
    "+": now(() => rig.zoom(0.86)),
    "=": now(() => rig.zoom(0.86)),
    "-": now(() => rig.zoom(1 / 0.86)),
    f: selected && (() => panel.goTo(current)),
    i: selected && (() => panel.isolate(panel.lineOf[current])),
    h: selected && (() => panel.toggle(panel.lineOf[current])),
    a: () => panel.showAll(),
    g: acts.groups,
    p: acts.play,
    Home: acts.home,
    "/": () => byId("search").focus(),
    "?": acts.help,
  };
  if (/^[1-9]$/.test(event.key)) return acts.bookmark(Number(event.key));
  return table[event.key] || null;
}
