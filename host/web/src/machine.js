// Picture of a machine: layers of the viewer from a state. All of it comes from the machine file,
// by the units, limits and places in the state: no machine is named here.
(function () {
'use strict';
// Drawn length of a force.
const FORCE_MM_PER_N = 0.5;

// Lower and upper corner of the workspace, from the coordinates of the tool tip; null without
// limits.
function workspace(message) {
  const xyz = message.tip_axes.map(index => index === null ? null : message.pose[index]);
  const low = xyz.map(axis => axis && axis.low !== null ? axis.low : 0);
  const high = xyz.map(axis => axis && axis.high !== null ? axis.high : 0);
  return low.some((value, k) => value !== high[k]) ? { low, high } : null;
}

function boxLayer({ low, high }) {
  const corner = k => [k & 1 ? high[0] : low[0], k & 2 ? high[1] : low[1], k & 4 ? high[2] : low[2]];
  const edges = [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5],
    [2, 6], [3, 7]];
  return { kind: 'lines', name: 'workspace', colour: '#9aa7b4', width: 1, aside: true,
    points: edges.flatMap(([i, j]) => [...corner(i), ...corner(j)]),
    starts: edges.map((_, k) => 2 * k) };
}

// Each linear joint as a rail with its carriage, each rotary one as a dial, side by side behind the
// workspace.
function jointsLayer(joints, { low, high }) {
  const width = Math.max(high[0] - low[0], 10), depth = high[1] + 0.1 * width;
  const height = Math.max(high[2] - low[2], 0.3 * width), size = width / joints.length;
  const points = [], starts = [];
  const stroke = (...places) => { starts.push(points.length / 3); places.forEach(p => points.push(...p)); };
  joints.forEach((joint, k) => {
    const x = low[0] + (k + 0.5) * size, radius = 0.35 * size;
    const at = (dx, dz) => [x + dx, depth, low[2] + dz];
    if (joint.actual === null) return;
    if (joint.low !== null && joint.high !== null && joint.unit === 'mm') {
      const part = (joint.actual - joint.low) / (joint.high - joint.low || 1) * height;
      stroke(at(0, 0), at(0, height));
      const [w, h] = [0.4 * radius, 0.03 * height];
      stroke(at(-w, part - h), at(w, part - h), at(w, part + h), at(-w, part + h), at(-w, part - h));
      return;
    }
    const place = angle => at(radius * Math.sin(angle), height / 2 + radius * Math.cos(angle));
    stroke(...Array.from({ length: 33 }, (_, j) => place(2 * Math.PI * j / 32)));
    stroke(at(0, height / 2), place(joint.actual * Math.PI / 180));
  });
  return { kind: 'lines', name: 'joints', colour: '#2e8b57', width: 2, aside: true, points, starts };
}

function linksLayer(links) {
  const starts = [];
  links.forEach((_, k) => starts.push(k ? starts[k - 1] + links[k - 1].length : 0));
  return { kind: 'lines', name: 'links', colour: '#b8860b', width: 4, aside: true,
    points: links.flat(2), starts };
}

// A ball where the direction of the tool is not known, else a cutter with its holder.
function toolLayer(tip, axis) {
  const rings = axis ? [[0, 0], [1, 1.6], [3, 3], [22, 3], [22, 9], [42, 9], [42, 0]]
    : [[0, 0], [1, 2.2], [3, 3], [5, 2.2], [6, 0]];
  const along = axis || [0, 0, 1];
  const cross = (u, v) => [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2],
    u[0] * v[1] - u[1] * v[0]];
  const unit = u => u.map(part => part / Math.hypot(...u));
  const first = unit(cross(Math.abs(along[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], along));
  const second = cross(along, first);
  const sides = 20;
  const points = [], triangles = [];
  rings.forEach(([height, radius], ring) => {
    for (let k = 0; k < sides; k += 1) {
      const [c, s] = [Math.cos(2 * Math.PI * k / sides), Math.sin(2 * Math.PI * k / sides)];
      for (let i = 0; i < 3; i += 1) {
        points.push(tip[i] + height * along[i] + radius * (c * first[i] + s * second[i]));
      }
      if (ring === 0) continue;
      const here = ring * sides + k, next = ring * sides + (k + 1) % sides;
      triangles.push(here, next, here - sides, next, next - sides, here - sides);
    }
  });
  return { kind: 'mesh', name: 'tool', colour: '#8393a3', opacity: 1, aside: true, points,
    triangles };
}

function forceLayer(tip, force) {
  return { kind: 'arrows', name: 'force', colour: '#c2185b', width: 3, aside: true, points: tip,
    vectors: force, magnify: FORCE_MM_PER_N };
}

// The layers of a state by name, each with what it depends on; null for one that is not shown.
function layers(message) {
  const space = workspace(message);
  const tip = message.referenced ? message.tip : null;
  const force = message.force || [0, 0, 0];
  const places = message.joints.map(joint => joint.actual && joint.actual.toFixed(2));
  const shown = (holds, key, make) => holds ? { key: JSON.stringify(key), make } : null;
  return {
    workspace: shown(space, space, () => boxLayer(space)),
    joints: shown(space && message.joints.length, [space, places],
      () => jointsLayer(message.joints, space)),
    links: shown(message.links.length, message.links, () => linksLayer(message.links)),
    tool: shown(tip && space, [tip, message.tool_axis], () => toolLayer(tip, message.tool_axis)),
    force: shown(tip && Math.hypot(...force) > 0.5, [tip, force], () => forceLayer(tip, force)),
  };
}

window.HaptimillMachine = { layers };
})();
