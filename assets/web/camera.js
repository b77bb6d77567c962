// Where the camera is: turned around a pivot, moved, and on its way to a shot. OpenCV axes.

const JUMP_MS = 450;
const STEEPEST = (89.9 * Math.PI) / 180; // straight up and down has no heading

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, scale = 1) => [a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => {
  const length = Math.hypot(...a) || 1;
  return a.map((x) => x / length);
};

/** Rows right, down, forward of a quaternion wxyz. */
function rowsOf([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** The quaternion wxyz of rows: of four candidates the longest. */
function quatOf([[a, b, c], [d, e, f], [g, h, i]]) {
  const candidates = [
    [1 + a + e + i, h - f, c - g, d - b],
    [h - f, 1 + a - e - i, b + d, c + g],
    [c - g, b + d, 1 - a + e - i, f + h],
    [d - b, c + g, f + h, 1 - a - e + i],
  ];
  return unit(candidates.reduce((best, q) => (Math.hypot(...q) > Math.hypot(...best) ? q : best)));
}

/** `a` turned by `angle` about the unit `axis`. */
function turned(a, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return plus(plus(a.map((x) => c * x), cross(axis, a), s), axis, (1 - c) * dot(axis, a));
}

class CameraRig {
  constructor(up, radius, jumps) {
    this.up = up;
    this.radius = radius;
    this.jumps = jumps; // whether ways are shown; false: the camera is there at once
    this.pose = null;
    this.way = null; // of a jump: from, to, begin in ms
  }

  /** A shot of the page: eye 3, quaternion 4, fields of view 2, distance 1. */
  static poseOf(shot) {
    const rows = rowsOf(unit(shot.slice(3, 7)));
    return {
      rows, pivot: plus(shot.slice(0, 3), rows[2], shot[9]),
      distance: shot[9], fovX: shot[7], fovY: shot[8],
    };
  }

  get eye() {
    return plus(this.pose.pivot, this.pose.rows[2], -this.pose.distance);
  }

  set(pose) {
    this.way = null;
    this.pose = pose;
  }

  jump(pose) {
    if (!this.jumps || !this.pose) this.set(pose);
    else this.way = { from: this.pose, to: pose, begin: performance.now() };
  }

  /** Go on with a jump; whether the camera moved. */
  update(now) {
    if (!this.way) return false;
    const t = Math.min(Math.max((now - this.way.begin) / JUMP_MS, 0), 1);
    this.pose = between(this.way.from, this.way.to, t * t * (3 - 2 * t));
    if (t >= 1) this.way = null;
    return true;
  }

  focal([width, height]) {
    const { fovX, fovY } = this.pose;
    return Math.min(width / 2 / Math.tan(fovX / 2), height / 2 / Math.tan(fovY / 2));
  }

  /** The view at this picture size: both fields of view are inside. */
  camera(size) {
    const { rows } = this.pose, eye = this.eye, focal = this.focal(size);
    const matrix = new Float32Array(16);
    rows.forEach((row, i) => matrix.set([...row, -dot(row, eye)], 4 * i));
    matrix[15] = 1;
    return { matrix, eye, size, lens: [focal, focal, size[0] / 2, size[1] / 2] };
  }

  /** Turn around the pivot by shares of the picture's height: half a turn a height. */
  orbit(dx, dy) {
    this.way = null;
    const { rows } = this.pose;
    const pitch = Math.asin(Math.min(Math.max(dot(rows[2], this.up), -1), 1));
    const goal = Math.min(Math.max(pitch - dy * Math.PI, -STEEPEST), STEEPEST);
    const level = unit(cross(rows[2], this.up));
    const whole = rows.map((row) => turned(turned(row, level, goal - pitch), this.up, -dx * Math.PI));
    this.pose = { ...this.pose, rows: whole };
  }

  /** Move sideways by pixels of a picture of this size: the pivot follows the pointer. */
  pan(dx, dy, size) {
    this.way = null;
    const { rows, distance, pivot } = this.pose;
    const step = distance / this.focal(size);
    this.pose = { ...this.pose, pivot: plus(plus(pivot, rows[0], -dx * step), rows[1], -dy * step) };
  }

  /** Go nearer (factor under 1) or away. */
  zoom(factor) {
    this.way = null;
    const distance = Math.min(Math.max(this.pose.distance * factor, 1e-3 * this.radius), 1e3 * this.radius);
    this.pose = { ...this.pose, distance };
  }

  /** Show a ball from the present direction. */
  focus(centre, radius) {
    const pose = this.way?.to ?? this.pose;
    const distance = (1.15 * Math.max(radius, 1e-4 * this.radius)) / Math.sin(Math.min(pose.fovX, pose.fovY) / 2);
    this.jump({ ...pose, pivot: centre, distance });
  }

  /** Turn around a point from now on: it comes to the middle, as far away as it is. */
  lookAt(point) {
    const { rows } = this.pose;
    const depth = dot(plus(point, this.eye, -1), rows[2]);
    if (depth > 0) this.jump({ ...this.pose, pivot: point, distance: depth });
  }
}

function between(a, b, t) {
  const mix = (x, y) => x + t * (y - x);
  const log = (x, y) => Math.exp(mix(Math.log(x), Math.log(y)));
  const p = quatOf(a.rows), q = quatOf(b.rows);
  const sign = p.reduce((sum, x, i) => sum + x * q[i], 0) < 0 ? -1 : 1;
  return {
    rows: rowsOf(unit(p.map((x, i) => mix(x, sign * q[i])))),
    pivot: a.pivot.map((x, i) => mix(x, b.pivot[i])),
    distance: log(a.distance, b.distance),
    fovX: log(a.fovX, b.fovX),
    fovY: log(a.fovY, b.fovY),
  };
}

/** The pose at a moment of a path: shots at even steps of time, from the first to the last. */
function poseAt(path, seconds) {
  const at = Math.min(Math.max((seconds / path.seconds) * (path.shots.length - 1), 0), path.shots.length - 1);
  const first = Math.min(Math.floor(at), path.shots.length - 2);
  return between(CameraRig.poseOf(path.shots[first]), CameraRig.poseOf(path.shots[first + 1]), at - first);
}
