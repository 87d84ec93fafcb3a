// A turntable of coloured triangles in WebGL 2: corners of three float32 [m] and four bytes of colour.

const VERTEX = `#version 300 es
in vec3 position; in vec4 color; uniform mat4 view; out vec3 place; out vec4 tint;
void main() { place = position; tint = color; gl_Position = view * vec4(position, 1.0); }`;
const FRAGMENT = `#version 300 es
precision highp float; in vec3 place; in vec4 tint; uniform vec3 eye; uniform vec4 paint; out vec4 result;
void main() {
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  normal *= sign(dot(normal, eye - place));
  float light = 0.45 + 0.35 * max(0.0, dot(normal, normalize(vec3(0.4, -0.5, 0.9)))) + 0.25 * max(0.0, dot(normal, normalize(eye - place)));
  result = vec4(mix(tint.rgb, paint.rgb, paint.a) * light, paint.a > 0.0 ? 0.35 : 1.0);
}`;
const CORNER = 16;

export class Robot {
  constructor(canvas, tell) {
    this.canvas = canvas;
    this.turn = -0.9; this.tilt = 0.3; this.zoom = 1; this.parts = {};
    this.gl = canvas.getContext("webgl2", { antialias: true });
    if (!this.gl) { tell("This browser draws no WebGL 2, so the body is not shown."); return; }
    this.prepare();
    this.drag();
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  prepare() {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source); gl.compileShader(shader); gl.attachShader(program, shader);
    }
    gl.linkProgram(program); gl.useProgram(program);
    this.program = program;
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  drag() {
    let from = null;
    this.canvas.addEventListener("pointerdown", (e) => { from = [e.clientX, e.clientY]; this.canvas.setPointerCapture(e.pointerId); });
    this.canvas.addEventListener("pointerup", () => { from = null; });
    this.canvas.addEventListener("pointermove", (e) => {
      if (!from) return;
      this.turn -= (e.clientX - from[0]) * 0.01;
      this.tilt = Math.max(-0.2, Math.min(1.5, this.tilt + (e.clientY - from[1]) * 0.01));
      from = [e.clientX, e.clientY];
      this.draw();
    });
    this.canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.zoom = Math.max(0.4, Math.min(4, this.zoom * Math.exp(-e.deltaY * 0.001)));
      this.draw();
    }, { passive: false });
  }

  // data: an ArrayBuffer of corners, or null to take the part away
  set(name, data) {
    const gl = this.gl;
    if (!gl) return;
    if (this.parts[name]) { gl.deleteBuffer(this.parts[name].buffer); delete this.parts[name]; }
    if (data) {
      const buffer = gl.createBuffer(), values = new DataView(data), high = [-Infinity, -Infinity, -Infinity];
      const low = [Infinity, Infinity, Infinity];
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer); gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      for (let at = 0; at < data.byteLength; at += CORNER) for (let k = 0; k < 3; k++) {
        const value = values.getFloat32(at + 4 * k, true);
        low[k] = Math.min(low[k], value); high[k] = Math.max(high[k], value);
      }
      this.parts[name] = { buffer, count: data.byteLength / CORNER, low, high };
    }
    this.draw();
  }

  draw() {
    const gl = this.gl, all = Object.values(this.parts);
    if (!gl) return;
    const ratio = window.devicePixelRatio || 1, width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    this.canvas.width = width * ratio; this.canvas.height = height * ratio;
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(1, 1, 1, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!all.length || !width || !height) return;
    const low = [0, 1, 2].map((k) => Math.min(...all.map((p) => p.low[k])));
    const high = [0, 1, 2].map((k) => Math.max(...all.map((p) => p.high[k])));
    const center = low.map((v, k) => (v + high[k]) / 2), radius = Math.hypot(...low.map((v, k) => high[k] - v)) / 2;
    const way = [Math.cos(this.tilt) * Math.cos(this.turn), Math.cos(this.tilt) * Math.sin(this.turn), Math.sin(this.tilt)];
    const distance = (3.1 * radius) / this.zoom / Math.min(1, width / height);
    const eye = center.map((v, k) => v + distance * way[k]);
    const right = [-Math.sin(this.turn), Math.cos(this.turn), 0];
    const up = [way[1] * right[2] - way[2] * right[1], way[2] * right[0] - way[0] * right[2], way[0] * right[1] - way[1] * right[0]];
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const near = distance / 50, far = distance + 4 * radius, f = 2.6, aspect = width / height;
    const a = (far + near) / (far - near), b = (-2 * far * near) / (far - near);
    const rows = [right.map((v) => (v * f) / aspect), up.map((v) => v * f), way.map((v) => -v)];
    const shift = [-dot(rows[0], eye), -dot(rows[1], eye), -dot(rows[2], eye)];
    const view = [0, 1, 2].flatMap((k) => [rows[0][k], rows[1][k], a * rows[2][k], rows[2][k]]);
    view.push(shift[0], shift[1], a * shift[2] + b, shift[2]);
    gl.uniformMatrix4fv(gl.getUniformLocation(this.program, "view"), false, view);
    gl.uniform3fv(gl.getUniformLocation(this.program, "eye"), eye);
    this.paint("best", [0, 0, 0, 0]);
    gl.enable(gl.BLEND); gl.depthMask(false);
    this.paint("nominal", [0.55, 0.58, 0.64, 1]);
    gl.depthMask(true); gl.disable(gl.BLEND);
  }

  paint(name, color) {
    const gl = this.gl, part = this.parts[name];
    if (!part) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, part.buffer);
    for (const [attribute, size, kind, normal, offset] of [["position", 3, gl.FLOAT, false, 0], ["color", 4, gl.UNSIGNED_BYTE, true, 12]]) {
      const at = gl.getAttribLocation(this.program, attribute);
      if (at < 0) continue;
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, kind, normal, CORNER, offset);
    }
    gl.uniform4fv(gl.getUniformLocation(this.program, "paint"), color);
    gl.drawArrays(gl.TRIANGLES, 0, part.count);
  }
}
