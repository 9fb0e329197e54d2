// Projects the axes by the script of the viewer, without a browser.
// Usage: node projection.js VIEWER
'use strict';
const fs = require('fs');
const vm = require('vm');
const window = {};
const document = { querySelectorAll: () => [] };
vm.runInNewContext(fs.readFileSync(process.argv[2], 'utf8'), { window, document });
const { matrixOf, project } = window.HaptimillViewer;
const [width, height] = [640, 480];
const rows = [];
for (const yaw of [-0.7, 0, Math.PI / 2, 2.5, -2.2]) {
  for (const pitch of [-1.2, 0, 0.6, Math.PI / 2]) {
    const camera = { yaw, pitch, target: [10, -20, 5], span: 300 };
    const m = matrixOf(camera, width, height, 100);
    const at = point => project(m, width, height, point);
    const zero = at([0, 0, 0]);
    // Change on the screen with a coordinate: to the right, up, towards the eye.
    const changes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(axis => {
      const [x, y, depth] = at(axis);
      return [x - zero[0], zero[1] - y, zero[2] - depth];
    });
    rows.push({ yaw, pitch, changes });
  }
}
console.log(JSON.stringify(rows));
