// Shift-and-sum in one fragment pass of WebGL2: every pixel reads the views that count.
// Four texelFetch make one bilinear sample: the hardware's own filter has weights of 8 bits.

import { planShifts } from "./shifts.js";

const VERTEX = `#version 300 es
void main() {  // one triangle that covers the canvas
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2DArray;
uniform usampler2DArray views;
uniform int used;
uniform float scale, offset, exponent;
// For each view: whole shifts (down, right), layer; parts of a lenslet, weight.
layout(std140) uniform Views { vec4 view[2 * MOST]; };
out vec4 colour;
vec3 at(ivec2 place, int layer) {
  return vec3(texelFetch(views, ivec3(place.yx, layer), 0).rgb);
}
void main() {
  ivec2 last = textureSize(views, 0).yx - 1;
  ivec2 here = ivec2(last.x - int(gl_FragCoord.y), int(gl_FragCoord.x));
  vec3 sum = vec3(0.0);
  for (int i = 0; i < used; i++) {
    vec4 place = view[2 * i], amount = view[2 * i + 1];
    ivec2 near = here + ivec2(place.xy);
    ivec2 a = clamp(near, ivec2(0), last), b = clamp(near + 1, ivec2(0), last);
    int layer = int(place.z);
    vec3 above = mix(at(a, layer), at(ivec2(a.x, b.y), layer), amount.y);
    vec3 below = mix(at(ivec2(b.x, a.y), layer), at(b, layer), amount.y);
    sum += amount.z * mix(above, below, amount.x);
  }
  vec3 shown = clamp(scale * sum + offset, 0.0, 1.0);
  if (exponent != 1.0) shown = pow(shown, vec3(exponent));  // pow(x, 1.0) would cost digits
  colour = vec4(GREY ? shown.rrr : shown, 1.0);
}`;

const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** Name of the graphics processor; nothing without WebGL2. */
export function rendererName(gl) {
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  return String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
}

/** Whether WebGL2 is there, holds the views, and is no software. */
export function hasFastWebGL({ views, size }) {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return false;
  const fits =
    views[0] * views[1] <= gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS) &&
    views[0] * views[1] * 32 <= gl.getParameter(gl.MAX_UNIFORM_BLOCK_SIZE) &&
    Math.max(...size) <= gl.getParameter(gl.MAX_TEXTURE_SIZE);
  const fast = !SOFTWARE.test(rendererName(gl));
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return fits && fast;
}

export class WebGLRenderer {
  constructor(canvas, shape, codes) {
    Object.assign(this, { canvas, shape, codes, pieces: [] });
    [canvas.height, canvas.width] = shape.size;
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.restore());
    this.start();
  }

  start() {
    const options = { antialias: false, alpha: false, preserveDrawingBuffer: true };
    const gl = (this.gl = this.canvas.getContext("webgl2", options));
    if (!gl) throw new Error("This browser has no WebGL2.");
    this.name = rendererName(gl);
    this.program = this.compile();
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.bindBuffer(gl.UNIFORM_BUFFER, gl.createBuffer());
    gl.bindBufferBase(gl.UNIFORM_BUFFER, 0, gl.getParameter(gl.UNIFORM_BUFFER_BINDING));
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, gl.createTexture());
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D_ARRAY, name, gl.NEAREST);
    }
    const wide = this.codes instanceof Uint16Array;
    const grey = this.shape.channels === 1;
    this.type = wide ? gl.UNSIGNED_SHORT : gl.UNSIGNED_BYTE;
    this.format = grey ? gl.RED_INTEGER : gl.RGB_INTEGER;
    const kinds = wide ? [gl.R16UI, gl.RGB16UI] : [gl.R8UI, gl.RGB8UI];
    const { views, size } = this.shape;
    const layers = views[0] * views[1];
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, kinds[grey ? 0 : 1], size[1], size[0], layers);
  }

  compile() {
    const { gl } = this;
    const grey = this.shape.channels === 1;
    const most = this.shape.views[0] * this.shape.views[1];
    const program = gl.createProgram();
    const fragment = FRAGMENT.replace("MOST", most).replace("GREY", grey);
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`WebGL2 refuses the program: ${gl.getProgramInfoLog(program)}`);
    }
    gl.uniformBlockBinding(program, gl.getUniformBlockIndex(program, "Views"), 0);
    return program;
  }

  add(first, count) {
    this.pieces.push([first, count]);
    this.upload(first, count);
  }

  upload(first, count) {
    const { gl } = this;
    const [height, width] = this.shape.size;
    const view = height * width * this.shape.channels;
    const some = this.codes.subarray(first * view, (first + count) * view);
    const { format, type } = this;
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, first, width, height, count, format, type, some);
  }

  /** A lost context comes back empty. */
  restore() {
    this.start();
    for (const [first, count] of this.pieces) this.upload(first, count);
    if (this.last) this.draw(this.last);
  }

  draw(picture) {
    this.last = picture;
    if (this.gl.isContextLost()) return;
    this.run(picture);
    this.drawn?.();
  }

  run({ slope, weights, show }) {
    const { gl } = this;
    const plan = planShifts(this.shape, slope, weights);
    const columns = this.shape.views[1];
    const table = [];
    plan.weights.forEach((weight, layer) => {
      if (weight === 0) return;
      const down = plan.down[Math.floor(layer / columns)];
      const across = plan.across[layer % columns];
      table.push(down.whole, across.whole, layer, 0, down.part, across.part, weight, 0);
    });
    gl.useProgram(this.program);
    const block = new Float32Array(8 * weights.length);
    block.set(table);
    gl.bufferData(gl.UNIFORM_BUFFER, block, gl.DYNAMIC_DRAW);
    gl.uniform1i(gl.getUniformLocation(this.program, "used"), table.length / 8);
    for (const name of ["scale", "offset", "exponent"]) {
      gl.uniform1f(gl.getUniformLocation(this.program, name), show[name]);
    }
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** The last image in units of full scale, as float32 (for tests). */
  read() {
    const { gl } = this;
    const [height, width] = this.shape.size;
    gl.getExtension("EXT_color_buffer_float");
    gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
    gl.bindRenderbuffer(gl.RENDERBUFFER, gl.createRenderbuffer());
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA32F, width, height);
    const target = gl.getParameter(gl.RENDERBUFFER_BINDING);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, target);
    const show = { scale: 1 / this.shape.levels, offset: 0, exponent: 1 };
    this.run({ ...this.last, show });
    const values = new Float32Array(4 * height * width);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, values);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return upright(values, height, width, this.shape.channels);
  }

  close() {
    this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }
}

function upright(values, height, width, channels) {
  const out = new Float32Array(height * width * channels);
  for (let t = 0; t < height; t++) {
    for (let s = 0; s < width; s++) {
      const from = 4 * ((height - 1 - t) * width + s);
      for (let c = 0; c < channels; c++) out[(t * width + s) * channels + c] = values[from + c];
    }
  }
  return out;
}
