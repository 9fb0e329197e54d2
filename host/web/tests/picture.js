// Fits the picture of each machine by the scripts of the page, without a browser.
// Usage: node picture.js VIEWER MACHINE; states by the name of the machine on standard input.
'use strict';
const fs = require('fs');
const vm = require('vm');
const window = {};
const document = { querySelectorAll: () => [] };
for (const script of process.argv.slice(2)) {
  vm.runInNewContext(fs.readFileSync(script, 'utf8'), { window, document });
}
const { matrixOf, project, fitted, boxOf } = window.HaptimillViewer;
const states = JSON.parse(fs.readFileSync(0, 'utf8'));
const pictures = {};
for (const [name, state] of Object.entries(states)) {
  const layers = Object.values(window.HaptimillMachine.layers(state))
    .filter(layer => layer).map(layer => layer.make());
  const places = layer => Array.from({ length: layer.points.length / 3 },
    (_, k) => layer.points.slice(3 * k, 3 * k + 3));
  const all = layers.flatMap(places);
  const segments = {};
  for (const layer of layers) {
    if (layer.starts) segments[layer.name] = layer.points.length / 3 - layer.starts.length;
  }
  const tool = layers.find(layer => layer.name === 'tool');
  const from = place => Math.hypot(...place.map((x, k) => x - state.tip[k]));
  const box = boxOf(all.flat());
  const size = Math.hypot(...box.high.map((x, k) => x - box.low[k]));
  const views = [];
  for (const [width, height] of [[850, 600], [370, 300]]) {
    for (const [yaw, pitch] of [[-0.7, 0.6], [0, Math.PI / 2], [0, 0], [Math.PI / 2, 0]]) {
      const camera = Object.assign({ yaw, pitch }, fitted({ yaw, pitch }, box, width, height));
      const m = matrixOf(camera, width, height, size / 2);
      const seen = all.map(place => project(m, width, height, place));
      const [x, y, depth] = [0, 1, 2].map(k => seen.map(place => place[k]));
      views.push({ width, height, yaw, pitch, left: Math.min(...x), right: Math.max(...x),
        top: Math.min(...y), bottom: Math.max(...y), near: Math.min(...depth),
        far: Math.max(...depth) });
    }
  }
  pictures[name] = { segments, tool_mm: tool ? Math.max(...places(tool).map(from)) : null, views };
}
console.log(JSON.stringify(pictures));
