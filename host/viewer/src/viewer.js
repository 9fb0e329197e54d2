// 3D viewer of scenes. The crate's documentation states the data format and the functions.
(function () {
'use strict';

const LINE_VERTEX = `#version 300 es
precision highp float;
in vec2 corner; in vec3 a; in vec3 b; in vec3 colourA; in vec3 colourB;
in float timeA; in float timeB;
uniform mat4 view; uniform vec2 size; uniform float width; uniform float until;
out vec3 colour;
void main() {
  float part = timeB > until ? (until - timeA) / max(timeB - timeA, 1e-9) : 1.0;
  vec4 from = view * vec4(a, 1.0);
  vec4 to = view * vec4(mix(a, b, clamp(part, 0.0, 1.0)), 1.0);
  vec2 along = (to.xy - from.xy) * size;
  float length2 = dot(along, along);
  along = length2 > 1e-9 ? along * inversesqrt(length2) : vec2(1.0, 0.0);
  vec4 at = corner.x < 0.5 ? from : to;
  // Half the width beyond both ends closes the joints of polylines.
  vec2 off = vec2(-along.y, along.x) * corner.y + along * (corner.x * 2.0 - 1.0);
  at.xy += off * width / size;
  if (timeA > until) at = vec4(2.0, 2.0, 2.0, 1.0);
  colour = mix(colourA, colourB, corner.x);
  gl_Position = at;
}`;
const LINE_FRAGMENT = `#version 300 es
precision highp float;
in vec3 colour; out vec4 pixel;
void main() { pixel = vec4(colour, 1.0); }`;
// Lines of one pixel, without instances: a renderer by software takes as long for an instance as
// for many vertices.
const THIN_VERTEX = `#version 300 es
precision highp float;
in vec3 a; in vec3 colourA; uniform mat4 view;
out vec3 colour;
void main() { colour = colourA; gl_Position = view * vec4(a, 1.0); }`;
const MESH_VERTEX = `#version 300 es
precision highp float;
in vec3 point; in vec3 tint; uniform mat4 view;
out vec3 colour; out vec3 place;
void main() { colour = tint; place = point; gl_Position = view * vec4(point, 1.0); }`;
const MESH_FRAGMENT = `#version 300 es
precision highp float;
in vec3 colour; in vec3 place; uniform vec3 eye; uniform float opacity; out vec4 pixel;
void main() {
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  float light = 0.35 + 0.65 * abs(dot(normal, normalize(eye + vec3(0.25, -0.1, 0.45))));
  pixel = vec4(colour * light, opacity);
}`;

// A picture that takes longer than this is slow. After so many of them in a row the scene goes one
// level down: lines are thin from level 1 on, and the resolution falls as listed.
const SLOW_PICTURE_MS = 50;
const SLOW_PICTURES = 3;
const RESOLUTIONS = [1, 1, 0.5, 0.35];
// Colour maps: dark to light, and blue over grey to red.
const MAPS = {
  sequential: ['#2b1e66', '#27508f', '#1c7f8c', '#2fa86b', '#8fc742', '#f2d024', '#e8590c'],
  diverging: ['#1f4e9c', '#5b8fd0', '#a9c2dd', '#d9d9d9', '#e6b39a', '#d66b4e', '#a3191f'],
};

function rgb(hex) {
  const value = parseInt(String(hex).replace('#', ''), 16) || 0;
  return [(value >> 16 & 255) / 255, (value >> 8 & 255) / 255, (value & 255) / 255];
}

function mapped(scale, value) {
  const stops = (MAPS[scale.map] || MAPS.sequential).map(rgb);
  const span = scale.high - scale.low || 1;
  const at = Math.min(Math.max((value - scale.low) / span, 0), 1) * (stops.length - 1);
  const low = Math.min(Math.floor(at), stops.length - 2);
  return [0, 1, 2].map(k => stops[low][k] + (stops[low + 1][k] - stops[low][k]) * (at - low));
}

// Numbers as an array, a typed array, or the base64 text of little-endian values of 4 bytes.
function numbers(data, Kind) {
  if (data === undefined || data === null) return new Kind(0);
  if (typeof data !== 'string') return Kind.from(data);
  const text = atob(data);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  return new Kind(bytes.buffer);
}

// Corners of the box around points; null without points.
function boxOf(points) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < points.length; k++) {
    low[k % 3] = Math.min(low[k % 3], points[k]);
    high[k % 3] = Math.max(high[k % 3], points[k]);
  }
  return points.length ? { low, high } : null;
}

// The box around boxes, of which some may be null.
function around(boxes) {
  return boxOf(boxes.filter(box => box).flatMap(box => [...box.low, ...box.high]));
}

function unpacked(layer) {
  const points = numbers(layer.points, Float32Array);
  const count = points.length / 3;
  const values = numbers(layer.values, Float32Array);
  const plain = rgb(layer.colour || '#2f6fb3');
  const colours = new Float32Array(count * 3);
  for (let k = 0; k < count; k++) {
    colours.set(values.length && layer.scale ? mapped(layer.scale, values[k]) : plain, 3 * k);
  }
  return {
    layer, points, values, colours, count,
    starts: numbers(layer.starts, Uint32Array),
    isStart: new Set(numbers(layer.starts, Uint32Array)),
    times: numbers(layer.times, Float32Array),
    lines: numbers(layer.lines, Uint32Array),
    triangles: numbers(layer.triangles, Uint32Array),
    vectors: numbers(layer.vectors, Float32Array),
    box: boxOf(points),
    visible: layer.visible !== false,
  };
}

// Segments as 14 floats: point, colour and time of both ends.
function segments(data) {
  const out = [];
  const put = (a, b, ca, cb, ta, tb) => out.push(...a, ...ca, ta, ...b, ...cb, tb);
  const point = k => data.points.subarray(3 * k, 3 * k + 3);
  const colour = k => data.colours.subarray(3 * k, 3 * k + 3);
  if (data.layer.kind === 'arrows') {
    const magnify = data.layer.magnify === undefined ? 1 : data.layer.magnify;
    for (let k = 0; k < data.count; k++) {
      const a = [...point(k)];
      const d = [...data.vectors.subarray(3 * k, 3 * k + 3)].map(part => part * magnify);
      const b = a.map((part, i) => part + d[i]);
      put(a, b, colour(k), colour(k), 0, 0);
      // Head: four strokes back from the end, across two directions normal to the arrow.
      const other = Math.abs(d[2]) < 0.9 * Math.hypot(...d) ? [0, 0, 1] : [1, 0, 0];
      const cross = (u, v) => [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0]];
      const length = Math.hypot(...d) || 1;
      const across = cross(d, other);
      const size = Math.hypot(...across) || 1;
      const first = across.map(part => part / size);
      const second = cross(d.map(part => part / length), first);
      for (const side of [first, second]) {
        for (const sign of [-1, 1]) {
          const tail = b.map((part, i) => part - 0.22 * d[i] + sign * 0.09 * length * side[i]);
          put(b, tail, colour(k), colour(k), 0, 0);
        }
      }
    }
    return new Float32Array(out);
  }
  const starts = data.starts.length ? data.starts : [0];
  let total = 0;
  for (let s = 0; s < starts.length; s++) {
    const end = s + 1 < starts.length ? starts[s + 1] : data.count;
    total += Math.max(end - starts[s] - 1, 0);
  }
  const packed = new Float32Array(total * 14);
  let at = 0;
  for (let s = 0; s < starts.length; s++) {
    const end = s + 1 < starts.length ? starts[s + 1] : data.count;
    for (let k = starts[s]; k + 1 < end; k++) {
      for (const end of [k, k + 1]) {
        packed.set(point(end), at); packed.set(colour(end), at + 3);
        packed[at + 6] = data.times.length ? data.times[end] : 0;
        at += 7;
      }
    }
  }
  return packed;
}

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) {
      throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return made;
}

function buffer(gl, data, target) {
  const made = gl.createBuffer();
  gl.bindBuffer(target || gl.ARRAY_BUFFER, made);
  gl.bufferData(target || gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
  return made;
}

function rounded(value) {
  return Number(value.toPrecision(4)).toString();
}

function element(parent, name, className, text) {
  const made = document.createElement(name);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  parent.appendChild(made);
  return made;
}

function dot(u, v) { return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]; }

// Directions on the screen and towards the eye. `right` times `up` is `eye`: no mirror image.
function basis(camera) {
  const [sy, cy, sp, cp] = [Math.sin(camera.yaw), Math.cos(camera.yaw),
    Math.sin(camera.pitch), Math.cos(camera.pitch)];
  return { right: [cy, sy, 0], up: [-sy * sp, cy * sp, cp], eye: [sy * cp, -cy * cp, sp] };
}

// Orthographic matrix by columns, for a stage of width `w` and height `h`; `size` is the length of
// the scene along the line of sight at most.
function matrixOf(camera, w, h, size) {
  const { right, up, eye } = basis(camera);
  const sy = 2 / camera.span, sx = sy * h / w;
  const depth = 2 / (4 * size + camera.span + 1);
  const rows = [right.map(x => x * sx), up.map(x => x * sy), eye.map(x => -x * depth)];
  const m = new Float32Array(16);
  for (let r = 0; r < 3; r++) {
    for (let c = 0; c < 3; c++) m[4 * c + r] = rows[r][c];
    m[12 + r] = -dot(rows[r], camera.target);
  }
  m[15] = 1;
  return m;
}

// Target and span with which a camera shows a box on a stage.
function fitted(camera, { low, high }, w, h) {
  const { right, up } = basis(camera);
  const size = high.map((x, k) => x - low[k]);
  const extent = axis => size.reduce((sum, part, k) => sum + Math.abs(part * axis[k]), 0);
  return { target: low.map((x, k) => 0.5 * (x + high[k])),
    span: 1.15 * Math.max(extent(up), extent(right) * h / w, 1e-3) };
}

// Place of a point on the stage: pixels from the left and from the top, and the depth, which grows
// away from the eye.
function project(m, w, h, point) {
  const at = r => m[r] * point[0] + m[4 + r] * point[1] + m[8 + r] * point[2] + m[12 + r];
  return [(at(0) + 1) / 2 * w, (1 - at(1)) / 2 * h, at(2)];
}

// Creates a view of a scene in an element.
function create(root, scene) {
  const unit = scene.unit || 'mm';
  const frame = element(root, 'div', 'hv');
  const stage = element(frame, 'div', 'hv-stage');
  if (scene.height) stage.style.height = scene.height + 'px';
  const canvas = element(stage, 'canvas');
  const overlay = element(stage, 'canvas');
  const gl = canvas.getContext('webgl2', { antialias: scene.smooth !== false });
  if (!gl) {
    frame.textContent = '';
    element(frame, 'div', 'hv-note', 'This browser has no WebGL 2, which the 3D view needs.');
    return null;
  }
  const linePrograms = program(gl, LINE_VERTEX, LINE_FRAGMENT);
  const thinPrograms = program(gl, THIN_VERTEX, LINE_FRAGMENT);
  const meshPrograms = program(gl, MESH_VERTEX, MESH_FRAGMENT);
  const corners = buffer(gl, new Float32Array([0, -1, 0, 1, 1, -1, 1, 1]));
  const layers = new Map();
  const bar = element(frame, 'div', 'hv-bar');
  const toggles = element(bar, 'span', 'hv-bar-layers');
  toggles.style.display = 'contents';
  const timeBar = element(frame, 'div', 'hv-bar');
  timeBar.style.display = 'none';
  const camera = { yaw: -0.7, pitch: 0.6, target: [0, 0, 0], span: 100 };
  const none = { low: [0, 0, 0], high: [0, 0, 0] };
  // Boxes of the part, which is what is not aside, and of all layers.
  let part = none, whole = none, showsWhole = true, isMoved = false, end = 0, until = Infinity, marker = null;
  let drawing = false, again = false, playing = null, pictures = 0;
  let level = 0, slow = 0;

  function upload(data) {
    data.buffers = [];
    const keep = (values, target) => { data.buffers.push(buffer(gl, values, target)); };
    if (data.layer.kind === 'mesh') {
      data.vao = gl.createVertexArray();
      gl.bindVertexArray(data.vao);
      for (const [name, values] of [['point', data.points], ['tint', data.colours]]) {
        keep(values);
        const at = gl.getAttribLocation(meshPrograms, name);
        gl.enableVertexAttribArray(at);
        gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 0, 0);
      }
      keep(data.triangles, gl.ELEMENT_ARRAY_BUFFER);
    } else {
      const packed = segments(data);
      data.instances = packed.length / 14;
      data.vao = gl.createVertexArray();
      gl.bindVertexArray(data.vao);
      gl.bindBuffer(gl.ARRAY_BUFFER, corners);
      const corner = gl.getAttribLocation(linePrograms, 'corner');
      gl.enableVertexAttribArray(corner);
      gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
      keep(packed);
      const begin = [['a', 3, 0], ['colourA', 3, 3], ['timeA', 1, 6]];
      const ends = [['b', 3, 7], ['colourB', 3, 10], ['timeB', 1, 13]];
      for (const [name, size, offset] of [...begin, ...ends]) {
        const at = gl.getAttribLocation(linePrograms, name);
        gl.enableVertexAttribArray(at);
        gl.vertexAttribPointer(at, size, gl.FLOAT, false, 56, 4 * offset);
        gl.vertexAttribDivisor(at, 1);
      }
      data.thin = gl.createVertexArray();
      gl.bindVertexArray(data.thin);
      for (const [name, size, offset] of begin.slice(0, 2)) {
        const at = gl.getAttribLocation(thinPrograms, name);
        gl.enableVertexAttribArray(at);
        gl.vertexAttribPointer(at, size, gl.FLOAT, false, 28, 4 * offset);
      }
    }
    gl.bindVertexArray(null);
  }

  // What a layer has in the memory of the graphics card.
  function release(data) {
    gl.deleteVertexArray(data.vao);
    if (data.thin) gl.deleteVertexArray(data.thin);
    data.buffers.forEach(made => gl.deleteBuffer(made));
  }

  // Boxes of the layers; end time.
  function bounds() {
    const all = [...layers.values()];
    const main = all.filter(data => !data.layer.aside && data.count > 0);
    whole = around(all.map(data => data.box)) || none;
    part = main.length ? around(main.map(data => data.box)) : whole;
    end = 0;
    for (const data of all) {
      if (data.times.length) end = Math.max(end, data.times[data.times.length - 1]);
    }
    const hasBoth = main.length > 0 && main.length < all.length;
    fits.forEach(button => { button.style.display = hasBoth ? '' : 'none'; });
    timeBar.style.display = end > 0 ? '' : 'none';
    slider.max = end;
    slider.step = end / 2000 || 1;
    if (until === Infinity) slider.value = end;
  }

  // Bounds, and the row of switches.
  function refresh() {
    bounds();
    toggles.textContent = '';
    for (const data of layers.values()) {
      const label = element(toggles, 'label');
      const box = element(label, 'input');
      box.type = 'checkbox';
      box.checked = data.visible;
      const name = data.layer.name;
      box.onchange = () => {
        const shown = layers.get(name);
        if (shown) shown.visible = box.checked;
        draw();
      };
      const key = element(label, 'i');
      key.style.background = data.values.length && data.layer.scale
        ? `linear-gradient(90deg,${(MAPS[data.layer.scale.map] || MAPS.sequential).join(',')})`
        : data.layer.colour || '#2f6fb3';
      label.appendChild(document.createTextNode(data.layer.name));
    }
  }

  function matrix() {
    // Nothing is cut off before or behind.
    const far = Math.hypot(...camera.target.map((x, k) =>
      Math.max(Math.abs(x - whole.low[k]), Math.abs(x - whole.high[k]))));
    return matrixOf(camera, stage.clientWidth || 1, stage.clientHeight || 1, far);
  }

  function place(point) {
    return project(matrix(), stage.clientWidth || 1, stage.clientHeight || 1, point);
  }

  // Fits the view to all layers, or to the part; without an argument to what it showed before.
  function fit(all) {
    if (all !== undefined) showsWhole = all;
    isMoved = false;
    Object.assign(camera, fitted(camera, showsWhole ? whole : part, stage.clientWidth || 1,
      stage.clientHeight || 1));
    draw();
  }

  // Fits the view again, unless the reader has moved it.
  function refit() {
    if (isMoved) draw();
    else fit();
  }

  // Position, line and value at a time: on the layer whose times contain it.
  function at(time) {
    let found = null;
    for (const data of layers.values()) {
      const t = data.times;
      if (!t.length || t[0] > time + 1e-9) continue;
      let first = 0, last = t.length - 1;
      while (first < last) {
        const middle = (first + last + 1) >> 1;
        if (t[middle] <= time) first = middle; else last = middle - 1;
      }
      const next = Math.min(first + 1, t.length - 1);
      const gap = data.isStart.has(next) ? 0 : Math.max(t[next] - t[first], 1e-9);
      const part = gap ? Math.min((time - t[first]) / gap, 1) : 0;
      const place = [0, 1, 2].map(k => data.points[3 * first + k]
        + part * (data.points[3 * next + k] - data.points[3 * first + k]));
      if (!found || t[first] >= found.since) {
        found = { since: t[first], place, line: data.lines[next], value: data.values[next],
          layer: data.layer };
      }
    }
    return found;
  }

  function paint() {
    pictures += 1;
    const sharp = window.devicePixelRatio || 1;
    const ratio = RESOLUTIONS[level] * sharp;
    const [w, h] = [stage.clientWidth, stage.clientHeight];
    for (const [part, scale] of [[canvas, ratio], [overlay, sharp]]) {
      if (part.width !== Math.round(w * scale) || part.height !== Math.round(h * scale)) {
        part.width = Math.round(w * scale);
        part.height = Math.round(h * scale);
      }
    }
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(1, 1, 1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const view = matrix();
    const shown = [...layers.values()].filter(data => data.visible);
    const opacity = data => data.layer.opacity === undefined ? 1 : data.layer.opacity;
    const isMesh = data => data.layer.kind === 'mesh';
    const ordered = [...shown.filter(data => isMesh(data) && opacity(data) >= 1),
      ...shown.filter(data => !isMesh(data)),
      ...shown.filter(data => isMesh(data) && opacity(data) < 1)];
    for (const data of ordered) {
      gl.bindVertexArray(data.vao);
      if (isMesh(data)) {
        gl.useProgram(meshPrograms);
        gl.uniformMatrix4fv(gl.getUniformLocation(meshPrograms, 'view'), false, view);
        gl.uniform3fv(gl.getUniformLocation(meshPrograms, 'eye'), basis(camera).eye);
        gl.uniform1f(gl.getUniformLocation(meshPrograms, 'opacity'), opacity(data));
        gl.enable(gl.POLYGON_OFFSET_FILL);
        gl.polygonOffset(1, 1);
        if (opacity(data) < 1) {
          gl.enable(gl.BLEND);
          gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
          gl.depthMask(false);
        }
        gl.drawElements(gl.TRIANGLES, data.triangles.length, gl.UNSIGNED_INT, 0);
        gl.disable(gl.BLEND);
        gl.depthMask(true);
        gl.disable(gl.POLYGON_OFFSET_FILL);
      } else if (level > 0 && !isFinite(until)) {
        gl.bindVertexArray(data.thin);
        gl.useProgram(thinPrograms);
        gl.uniformMatrix4fv(gl.getUniformLocation(thinPrograms, 'view'), false, view);
        gl.drawArrays(gl.LINES, 0, 2 * data.instances);
      } else {
        gl.useProgram(linePrograms);
        gl.uniformMatrix4fv(gl.getUniformLocation(linePrograms, 'view'), false, view);
        gl.uniform2f(gl.getUniformLocation(linePrograms, 'size'), canvas.width, canvas.height);
        gl.uniform1f(gl.getUniformLocation(linePrograms, 'width'),
          (data.layer.width || 1.5) * ratio);
        gl.uniform1f(gl.getUniformLocation(linePrograms, 'until'),
          data.times.length && isFinite(until) ? until : 3e38);
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, data.instances);
      }
    }
    gl.bindVertexArray(null);
    annotate(w, h, sharp, shown);
  }

  function annotate(w, h, ratio, shown) {
    const pen = overlay.getContext('2d');
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.font = '12px system-ui,sans-serif';
    pen.lineWidth = 2;
    const { right, up } = basis(camera);
    ['#c0392b', '#2e8b57', '#2f6fb3'].forEach((colour, k) => {
      const [x, y] = [46 + 30 * right[k], h - 46 - 30 * up[k]];
      pen.strokeStyle = pen.fillStyle = colour;
      pen.beginPath();
      pen.moveTo(46, h - 46);
      pen.lineTo(x, y);
      pen.stroke();
      pen.fillText('XYZ'[k], x + 6 * right[k] - 4, y - 6 * up[k] + 4);
    });
    // Readable over a dark surface, too.
    const sheet = (x, y, width, height) => {
      pen.fillStyle = 'rgba(255,255,255,0.85)';
      pen.fillRect(x, y, width, height);
    };
    sheet(92, h - 60, 150, 54);
    pen.fillStyle = '#5b6875';
    'XYZ'.split('').forEach((name, k) => {
      const text = `${name} ${rounded(part.low[k])} to ${rounded(part.high[k])} ${unit}`;
      pen.fillText(text, 96, h - 46 + 16 * k);
    });
    const scales = new Map();
    for (const data of shown) {
      if (data.values.length && data.layer.scale) {
        scales.set(data.layer.scale.label, data.layer.scale);
      }
    }
    let top = 16;
    if (scales.size) sheet(8, 4, 196, 54 * scales.size);
    for (const scale of scales.values()) {
      const ramp = pen.createLinearGradient(16, 0, 196, 0);
      const stops = MAPS[scale.map] || MAPS.sequential;
      stops.forEach((colour, k) => ramp.addColorStop(k / (stops.length - 1), colour));
      pen.fillStyle = '#1d2733';
      pen.fillText(scale.label, 16, top + 4);
      pen.fillStyle = ramp;
      pen.fillRect(16, top + 10, 180, 9);
      pen.fillStyle = '#5b6875';
      pen.fillText(rounded(scale.low), 16, top + 33);
      const text = rounded(scale.high);
      pen.fillText(text, 196 - pen.measureText(text).width, top + 33);
      top += 54;
    }
    const time = isFinite(until) ? until : end;
    const here = end > 0 ? at(time) : null;
    const spot = marker || (here && isFinite(until) ? here.place : null);
    if (spot) {
      const [x, y] = place(spot);
      pen.strokeStyle = '#c0392b';
      pen.beginPath();
      pen.arc(x, y, 6, 0, 2 * Math.PI);
      pen.moveTo(x - 10, y); pen.lineTo(x + 10, y);
      pen.moveTo(x, y - 10); pen.lineTo(x, y + 10);
      pen.stroke();
    }
    clock.textContent = `${time.toFixed(2)} s of ${end.toFixed(2)} s`
      + (here && here.line !== undefined ? `, line ${here.line}` : '')
      + (here && here.value !== undefined && here.layer.scale
        ? `, ${here.layer.scale.label}: ${rounded(here.value)}` : '');
  }

  // After a slow picture the renderer rests as long as the picture took. Otherwise the timers of
  // the page are late, and a held jog button repeats its press too late for the jog timeout.
  function draw() {
    if (drawing) {
      again = true;
      return;
    }
    drawing = true;
    requestAnimationFrame(() => {
      const begun = performance.now();
      paint();
      requestAnimationFrame(() => {
        const took = performance.now() - begun;
        // A level is for good: the picture does not change to and fro.
        slow = took > SLOW_PICTURE_MS ? slow + 1 : 0;
        if (slow === SLOW_PICTURES && level < RESOLUTIONS.length - 1) {
          level += 1;
          slow = 0;
        }
        setTimeout(() => {
          drawing = false;
          if (again) {
            again = false;
            draw();
          }
        }, took > SLOW_PICTURE_MS ? Math.min(took, 1000) : 0);
      });
    });
  }

  function setLayer(layer) {
    const before = layers.get(layer.name);
    const data = unpacked(layer);
    if (before) {
      data.visible = before.visible;
      release(before);
    }
    upload(data);
    layers.set(layer.name, data);
    // The switches stay while a layer moves: a click may be under way.
    if (before) bounds();
    else refresh();
    draw();
  }

  function setTime(time) {
    until = time === null || time >= end ? Infinity : time;
    slider.value = isFinite(until) ? until : end;
    draw();
  }

  for (const [name, yaw, pitch] of [['3D', -0.7, 0.6], ['top', 0, Math.PI / 2], ['front', 0, 0],
    ['right', Math.PI / 2, 0]]) {
    element(bar, 'button', '', name).onclick = () => {
      camera.yaw = yaw;
      camera.pitch = pitch;
      fit();
    };
  }
  const fits = [['part', false], ['all', true]].map(([name, all]) => {
    const button = element(bar, 'button', '', name);
    button.onclick = () => fit(all);
    return button;
  });
  timeBar.title = 'The planned path over time; the machine does not move';
  const play = element(timeBar, 'button', '', 'play');
  const slider = element(timeBar, 'input');
  slider.type = 'range';
  slider.min = 0;
  const clock = element(timeBar, 'span', 'hv-time');
  slider.oninput = () => setTime(Number(slider.value));
  play.onclick = () => {
    if (playing) {
      cancelAnimationFrame(playing);
      playing = null;
      play.textContent = 'play';
      return;
    }
    play.textContent = 'pause';
    let last = performance.now();
    if (!isFinite(until)) setTime(0);
    // A program of any length plays in 30 s, a short one in its own time.
    const speed = Math.max(end / 30, 1);
    const step = now => {
      setTime((isFinite(until) ? until : end) + (now - last) / 1000 * speed);
      last = now;
      if (isFinite(until)) playing = requestAnimationFrame(step);
      else { playing = null; play.textContent = 'play'; }
    };
    playing = requestAnimationFrame(step);
  };

  // One pointer turns (with the right button or Shift it moves) the view; two zoom and move it.
  const pointers = new Map();
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { size: Math.hypot(a[0] - b[0], a[1] - b[1]), x: (a[0] + b[0]) / 2, y: (a[1] + b[1]) / 2 };
  };
  const pan = (dx, dy) => {
    const { right, up } = basis(camera);
    const step = camera.span / stage.clientHeight;
    camera.target = camera.target.map((x, k) => x + step * (up[k] * dy - right[k] * dx));
  };
  let moves = false;
  stage.onpointerdown = event => {
    moves = event.button > 0 || event.shiftKey;
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    stage.setPointerCapture(event.pointerId);
  };
  const leave = event => pointers.delete(event.pointerId);
  stage.onpointerup = leave;
  stage.onpointercancel = leave;
  stage.oncontextmenu = event => event.preventDefault();
  stage.onpointermove = event => {
    const last = pointers.get(event.pointerId);
    if (!last || pointers.size > 2) return;
    const here = [event.clientX, event.clientY];
    if (pointers.size === 2) {
      const before = spread();
      pointers.set(event.pointerId, here);
      const now = spread();
      camera.span *= before.size / Math.max(now.size, 1);
      pan(now.x - before.x, now.y - before.y);
    } else {
      pointers.set(event.pointerId, here);
      const [dx, dy] = [here[0] - last[0], here[1] - last[1]];
      if (moves) {
        pan(dx, dy);
      } else {
        camera.yaw -= dx * 0.008;
        camera.pitch = Math.min(Math.max(camera.pitch + dy * 0.008, -Math.PI / 2), Math.PI / 2);
      }
    }
    isMoved = true;
    draw();
  };
  stage.addEventListener('wheel', event => {
    event.preventDefault();
    isMoved = true;
    camera.span *= Math.exp(event.deltaY * 0.0012);
    draw();
  }, { passive: false });
  if (window.ResizeObserver) new ResizeObserver(refit).observe(stage);

  (scene.layers || []).forEach(setLayer);
  if (scene.view) {
    camera.yaw = scene.view[0] * Math.PI / 180;
    camera.pitch = scene.view[1] * Math.PI / 180;
  }
  fit();
  return {
    setLayer, setTime, fit, refit, project: place,
    // Number of pictures drawn so far.
    drawn: () => pictures,
    removeLayer: name => {
      if (!layers.has(name)) return;
      release(layers.get(name));
      layers.delete(name);
      refresh();
      draw();
    },
    setMarker: place => { marker = place; draw(); },
  };
}

window.HaptimillViewer = { create, matrixOf, project, fitted, boxOf };
// Scenes that are written into the page.
for (const data of document.querySelectorAll('script[data-haptimill-scene]')) {
  const root = document.createElement('div');
  data.parentNode.insertBefore(root, data);
  root.view = create(root, JSON.parse(data.textContent));
}
})();
