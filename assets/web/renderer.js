// Draws the splats with the shaders of the desktop window: project, blend far to near, finish.

const QUADS = 128; // quads an instance
const HIDDEN = 2; // bits of State
const SELECTED = 1;
const T_MIN = 1e-4; // light that is left where blending stops, as in gaga_core/raster/base.py
const MODES = { color: 0, groups: 1 };

/** A message for the person who opened the page. */
class PageError extends Error {}

class Renderer {
  constructor(canvas, splats, palette, antialiased) {
    const options = { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" };
    const gl = canvas.getContext("webgl2", options);
    if (!gl) throw new PageError("This page needs WebGL 2. Open it in a newer browser, or switch hardware acceleration on.");
    if (splats.lines > gl.getParameter(gl.MAX_TEXTURE_SIZE)) {
      throw new PageError("This scene has more splats than the graphics of this device can hold.");
    }
    this.gl = gl;
    this.splats = splats;
    this.antialiased = antialiased;
    // Color is half float where it can be: rounding to 8 bits at each layer shows.
    this.isFloat = Boolean(gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float"));
    this.nOrder = 0;
    this.order = null; // as it was sent
    this.drawn = null; // order and its length of the last picture
    this.state = new Uint8Array(splats.lines * WIDTH);
    this.programs = new Map();
    this.empty = gl.createVertexArray();
    this.quads = this.makeQuads();
    this.textures = this.makeTextures(palette);
    this.projected = this.makeTarget([gl.RGBA32UI, gl.RG32UI], WIDTH, splats.lines);
    this.blended = null;
    this.ellipses = null; // as they were read back
  }

  // --- what is drawn

  /** Draw these splats, far to near: `count` numbers, with room for whole lines of texels. */
  setOrder(order, count) {
    const gl = this.gl;
    const lines = Math.ceil(count / WIDTH);
    this.order = order;
    this.nOrder = count;
    gl.bindTexture(gl.TEXTURE_2D, this.textures.u_order);
    if (lines > 0) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, WIDTH, lines, gl.RED_INTEGER, gl.UNSIGNED_INT, order);
  }

  /** Hide and select by object: an array of flags for each. */
  setState(hidden, selected) {
    const { labels, n } = this.splats;
    for (let i = 0; i < n; i++) {
      this.state[i] = (hidden[labels[i]] ? HIDDEN : 0) | (selected[labels[i]] ? SELECTED : 0);
    }
    const gl = this.gl;
    gl.bindTexture(gl.TEXTURE_2D, this.textures.u_state);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, WIDTH, this.splats.lines, gl.RED_INTEGER, gl.UNSIGNED_BYTE, this.state);
  }

  /** Draw to the canvas. `look`: mode, hovered (object or 0), outlined, background, pixelScale, threshold. */
  draw(camera, look) {
    const gl = this.gl;
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    this.ellipses = null;
    this.drawn = { order: this.order, n: this.nOrder };
    this.project(camera, look);
    this.blend(camera, look.outlined);
    this.finish(camera, look);
  }

  project(camera, look) {
    const gl = this.gl;
    const program = this.program("full.vert", "project.frag", { N_SH: this.splats.nSh, N_LAYERS: this.splats.layers ?? 0 });
    gl.useProgram(program.handle);
    this.bind(program, this.textures);
    gl.uniform1i(program.at.u_count, this.nOrder);
    gl.uniformMatrix4fv(program.at.u_cam_from_world, true, camera.matrix);
    gl.uniform3fv(program.at.u_eye, camera.eye);
    gl.uniform4fv(program.at.u_lens, camera.lens);
    gl.uniform2fv(program.at.u_size, camera.size);
    gl.uniform2fv(program.at.u_log_scale, this.splats.logScale);
    gl.uniform1i(program.at.u_mode, MODES[look.mode]);
    gl.uniform1i(program.at.u_hovered, look.hovered);
    gl.uniform1i(program.at.u_antialiased, this.antialiased ? 1 : 0);
    gl.uniform1i(program.at.u_tinted, 0);
    gl.uniform1f(program.at.u_threshold, look.threshold);
    this.begin(this.projected, WIDTH, Math.max(1, Math.ceil(this.nOrder / WIDTH)));
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  blend(camera, outlined) {
    const gl = this.gl;
    const [width, height] = camera.size;
    const key = `${width} ${height} ${outlined}`;
    if (this.blended?.key !== key) {
      this.release(this.blended);
      const formats = [this.isFloat ? gl.RGBA16F : gl.RGBA8, ...(outlined ? [gl.RGBA8] : [])];
      this.blended = this.makeTarget(formats, width, height);
      this.blended.key = key;
    }
    this.begin(this.blended, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const program = this.program("quads.vert", "quads.frag", outlined ? { MASK: 1 } : {});
    gl.useProgram(program.handle);
    this.bind(program, { u_ellipses: this.projected.textures[0], u_looks: this.projected.textures[1] });
    gl.uniform1i(program.at.u_count, this.nOrder);
    gl.uniform1i(program.at.u_first, 0);
    gl.uniform2f(program.at.u_size, width, height);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.bindVertexArray(this.quads);
    const n = Math.ceil(this.nOrder / QUADS);
    if (n > 0) gl.drawElementsInstanced(gl.TRIANGLES, 6 * QUADS, gl.UNSIGNED_SHORT, 0, n);
    gl.disable(gl.BLEND);
  }

  finish(camera, look) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
    const program = this.program("full.vert", "composite.frag", look.outlined ? { MASK: 1 } : {});
    gl.useProgram(program.handle);
    const [u_splats, u_mask] = this.blended.textures;
    this.bind(program, look.outlined ? { u_splats, u_mask } : { u_splats });
    gl.uniform2f(program.at.u_picture, gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.uniform3fv(program.at.u_background, look.background);
    gl.uniform2f(program.at.u_outline, 2 * look.pixelScale, 1.2 * look.pixelScale);
    gl.uniform3f(program.at.u_accent, 0.36, 0.66, 1);
    gl.uniform3f(program.at.u_hover, 1, 1, 1);
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // --- what is at a pixel

  /**
   * Blend the one pixel whose centre is (u, v) front to back, from the projected splats of the last
   * picture: the object of greatest summed weight, and the splat where half of the light is gone.
   */
  pick(u, v) {
    if (!this.drawn) return null;
    const { order, n } = this.drawn; // a later order may wait to be drawn
    const words = this.readEllipses();
    const floats = new Float32Array(words.buffer);
    const { labels } = this.splats;
    const sums = new Map();
    const hits = [];
    let light = 1;
    for (let k = n - 1; k >= 0; k--) {
      const tail = words[4 * k + 3];
      if (tail === 0) continue;
      const dx = u - floats[4 * k], dy = v - floats[4 * k + 1];
      const alpha = alphaAt(dx, dy, words[4 * k + 2], tail);
      if (alpha < 1 / 255) continue;
      if (light * (1 - alpha) < T_MIN) break;
      const splat = order[k];
      sums.set(labels[splat], (sums.get(labels[splat]) ?? 0) + light * alpha);
      light *= 1 - alpha;
      hits.push([splat, 1 - light]);
    }
    if (hits.length === 0) return null;
    const covered = hits[hits.length - 1][1];
    const half = covered >= 0.5 ? 0.5 : covered / 2;
    const object = [...sums].reduce((a, b) => (b[1] > a[1] || (b[1] === a[1] && b[0] < a[0]) ? b : a))[0];
    return { object, splat: hits.find((hit) => hit[1] >= half)[0] };
  }

  readEllipses() {
    if (this.ellipses) return this.ellipses;
    const gl = this.gl;
    const lines = Math.max(1, Math.ceil(this.drawn.n / WIDTH));
    const words = new Uint32Array(4 * WIDTH * lines);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.projected.framebuffer);
    gl.readBuffer(gl.COLOR_ATTACHMENT0);
    gl.readPixels(0, 0, WIDTH, lines, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
    this.ellipses = words;
    return words;
  }

  // --- OpenGL objects

  program(vertex, fragment, defines) {
    const key = JSON.stringify([fragment, defines]);
    if (!this.programs.has(key)) this.programs.set(key, this.compile(vertex, fragment, defines));
    return this.programs.get(key);
  }

  compile(vertex, fragment, defines) {
    const gl = this.gl;
    const types = ["sampler2D", "isampler2D", "usampler2D", "usampler2DArray"];
    const head = ["#version 300 es"]
      .concat(Object.entries(defines).map(([name, value]) => `#define ${name} ${value}`))
      .concat(["float", "int", ...types].map((type) => `precision highp ${type};`))
      .join("\n");
    const handle = gl.createProgram();
    for (const [kind, name] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, `${head}\n${SHADERS["common.glsl"]}\n${SHADERS[name]}`);
      gl.compileShader(shader);
      gl.attachShader(handle, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
        throw new PageError(`The graphics driver refuses ${name}: ${gl.getShaderInfoLog(shader)}`);
      }
    }
    gl.bindAttribLocation(handle, 0, "in_corner");
    gl.linkProgram(handle);
    if (!gl.getProgramParameter(handle, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new PageError(`The graphics driver refuses ${fragment}: ${gl.getProgramInfoLog(handle)}`);
    }
    const at = {}, samplers = [];
    for (let i = 0; i < gl.getProgramParameter(handle, gl.ACTIVE_UNIFORMS); i++) {
      const { name, type } = gl.getActiveUniform(handle, i);
      at[name] = gl.getUniformLocation(handle, name);
      if (type === gl.UNSIGNED_INT_SAMPLER_2D_ARRAY) samplers.push([name, gl.TEXTURE_2D_ARRAY]);
      else if ([gl.SAMPLER_2D, gl.INT_SAMPLER_2D, gl.UNSIGNED_INT_SAMPLER_2D].includes(type)) samplers.push([name, gl.TEXTURE_2D]);
    }
    return { handle, at, samplers };
  }

  bind(program, textures) {
    const gl = this.gl;
    program.samplers.forEach(([name, target], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, textures[name]);
      gl.uniform1i(program.at[name], unit);
    });
    gl.activeTexture(gl.TEXTURE0);
  }

  makeTextures(palette) {
    const gl = this.gl;
    const { lines, means, shape, color, sh, layers, labels } = this.splats;
    const column = (internal, format, type, data) => this.makeTexture(internal, WIDTH, lines, format, type, data);
    const none = this.makeTexture(gl.R32UI, 1, 1, gl.RED_INTEGER, gl.UNSIGNED_INT, new Uint32Array(1));
    const textures = {
      u_order: column(gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT, null),
      u_means: column(gl.RGB32F, gl.RGB, gl.FLOAT, means),
      u_shape: column(gl.RGBA32UI, gl.RGBA_INTEGER, gl.UNSIGNED_INT, new Uint32Array(shape.buffer)),
      u_color: column(gl.RGBA16F, gl.RGBA, gl.FLOAT, color),
      u_state: column(gl.R8UI, gl.RED_INTEGER, gl.UNSIGNED_BYTE, this.state),
      u_labels: column(gl.R32I, gl.RED_INTEGER, gl.INT, labels),
      u_placement: column(gl.R8UI, gl.RED_INTEGER, gl.UNSIGNED_BYTE, this.state),
      u_placements: this.makeTexture(gl.RGBA32F, 16, 1, gl.RGBA, gl.FLOAT, placedAsWritten()),
      u_palette: this.makeTexture(gl.RGBA32F, WIDTH, palette.length / 4 / WIDTH, gl.RGBA, gl.FLOAT, palette),
      u_confidence: none,
      u_identity: none,
      u_tint: none,
    };
    if (sh) {
      textures.u_sh = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D_ARRAY, textures.u_sh);
      gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.RG32UI, WIDTH, lines, layers, 0, gl.RG_INTEGER, gl.UNSIGNED_INT, sh);
      this.pixelwise(gl.TEXTURE_2D_ARRAY, gl.NEAREST);
    }
    return textures;
  }

  makeTexture(internal, width, height, format, type, data) {
    const gl = this.gl;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, type, data);
    this.pixelwise(gl.TEXTURE_2D, gl.NEAREST);
    return texture;
  }

  pixelwise(target, filter) {
    const gl = this.gl;
    gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, filter);
    gl.texParameteri(target, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  }

  makeTarget(formats, width, height) {
    const gl = this.gl;
    const framebuffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    const textures = formats.map((format, i) => {
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
      this.pixelwise(gl.TEXTURE_2D, [gl.RGBA16F, gl.RGBA8].includes(format) ? gl.LINEAR : gl.NEAREST);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, texture, 0);
      return texture;
    });
    gl.drawBuffers(formats.map((_, i) => gl.COLOR_ATTACHMENT0 + i));
    return { framebuffer, textures };
  }

  begin(target, width, height) {
    this.gl.bindFramebuffer(this.gl.FRAMEBUFFER, target.framebuffer);
    this.gl.viewport(0, 0, width, height);
  }

  release(target) {
    if (!target) return;
    target.textures.forEach((texture) => this.gl.deleteTexture(texture));
    this.gl.deleteFramebuffer(target.framebuffer);
  }

  makeQuads() {
    const gl = this.gl;
    const corners = new Float32Array(QUADS * 12), indices = new Uint16Array(QUADS * 6);
    for (let k = 0; k < QUADS; k++) {
      corners.set([-1, -1, k, 1, -1, k, 1, 1, k, -1, 1, k], 12 * k);
      indices.set([0, 1, 2, 0, 2, 3].map((corner) => corner + 4 * k), 6 * k);
    }
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    return array;
  }
}

/** The one row of placements: nothing is moved or recolored, edits are in the columns. */
function placedAsWritten() {
  const texels = new Float32Array(64);
  for (const first of [0, 3, 6]) for (let k = 0; k < 3; k++) texels[4 * (first + k) + k] = 1;
  texels[36] = 1;
  return texels;
}

/** Alpha of a projected splat at (dx, dy) pixels from its centre, as in quads.frag. */
function alphaAt(dx, dy, axis, tail) {
  const ax = ofHalf(axis & 0xffff), ay = ofHalf(axis >>> 16);
  const long2 = ax * ax + ay * ay;
  const along = (dx * ax + dy * ay) / long2;
  const across = (dy * ax - dx * ay) / (Math.sqrt(long2) * ofHalf(tail & 0xffff));
  const r = along * along + across * across;
  if (!(r <= 1)) return 0;
  const opacity = (tail >>> 16) / 65535;
  return Math.min(0.99, opacity * Math.exp(-Math.log(255 * opacity) * r));
}

/** A length that common.glsl packed into 16 bits. */
function ofHalf(word) {
  const bits = word & 0x7fff;
  const value = bits === 0 ? 0 : 2 ** ((bits >> 10) - 15) * (1 + (bits & 1023) / 1024) * 16;
  return word & 0x8000 ? -value : value;
}
