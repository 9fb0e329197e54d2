// The live view; `haptimill-web` has the messages.
'use strict';
(() => {
const at = id => document.getElementById(id);
const token = new URLSearchParams(location.hash.slice(1)).get('token');
const LONGEST = 8 * 1024 * 1024;
// A jog button repeats its press four times within the shortest usual jog timeout, 200 ms.
const REPEAT_MS = 50;
// Points of the done path at most; beyond, every second one is left out.
const MOST_DONE = 20000;
// Length of the plot, and the colours of its lines.
const PLOT_S = 60;
const SYSTEMS = ['G54', 'G55', 'G56', 'G57', 'G58', 'G59', 'G59.1', 'G59.2', 'G59.3'];
const COLOURS = ['#0072b2', '#d55e00', '#009e73', '#cc79a7'];

let socket = null;
let state = null;
let control = { you: 0, commander: null, asks: null };
let newest = 0;
let view = null;
let scene = null;
let held = null;
let done = [];
let wasRunning = false;
let drawn = 0;
const local = [];

function send(command) {
  if (socket && socket.readyState === WebSocket.OPEN) {
    socket.send(JSON.stringify(Object.assign({ t: newest }, command)));
  }
}

function say(text) {
  local.push(text);
  local.splice(0, local.length - 5);
  at('note').textContent = text;
  clearTimeout(say.timer);
  say.timer = setTimeout(() => { at('note').textContent = ''; }, 6000);
}

function connect() {
  const query = token ? `?token=${token}` : '';
  socket = new WebSocket(`ws://${location.host}/ws${query}`);
  socket.onmessage = event => {
    const message = JSON.parse(event.data);
    ({ state: showState, scene: showScene, stock: showStock, 'stock-part': showStockPart,
      control: showControl, programs: showPrograms,
      refused: refused => say(refused.text) })[message.kind](message);
  };
  socket.onclose = () => {
    endJog();
    state = null;
    at('state').textContent = 'no connection to haptimill serve';
    at('state').className = 'state bad';
    document.body.classList.add('old');
    setTimeout(connect, 1000);
  };
}

function commands() {
  return control.commander !== null && control.commander === control.you;
}

function showControl(message) {
  control = message;
  const mine = commands();
  at('control').textContent = `viewer ${message.you}, ${message.viewers} connected: `
    + (mine ? 'you command' : message.commander === null ? 'nobody commands'
      : `viewer ${message.commander} commands`)
    + (message.asks === message.you ? '; asked for control' : '');
  at('take').disabled = mine || message.asks === message.you;
  at('ask').hidden = !(mine && message.asks !== null);
  at('ask').firstElementChild.textContent =
    `Viewer ${message.asks} asks for control. Without an answer it gets it after 10 s.`;
  if (!mine) endJog();
  enableButtons();
}

function enableButtons() {
  const mine = commands() && state !== null;
  for (const button of document.querySelectorAll(
    '[data-command], .jog, .zero, #run, #file, .percent, #programs, #slower, #faster, #question button, '
    + '#problems button')) {
    button.disabled = !mine;
  }
}

function showPrograms(message) {
  const list = at('programs');
  const chosen = state && state.selected;
  list.replaceChildren(new Option('part program', ''),
    ...message.names.map(name => new Option(name, name)));
  list.value = chosen || '';
}

function showScene(message) {
  if (!view) return;
  for (const layer of scene ? scene.layers : []) view.removeLayer(layer.name);
  scene = message.scene;
  for (const layer of scene ? scene.layers : []) view.setLayer(layer);
  done = [];
  view.removeLayer('done');
  view.fit(!scene);
}

function number(value, digits) {
  if (value === null || value === undefined) return '-';
  const text = value.toFixed(digits);
  return Number(text) === 0 ? (0).toFixed(digits) : text;
}

function cells(row, values) {
  values.forEach((value, index) => {
    const cell = row.children[index];
    if (cell.textContent !== value) cell.textContent = value;
  });
}

function rows(body, count, columns, make) {
  while (body.children.length > count) body.lastChild.remove();
  while (body.children.length < count) {
    const row = document.createElement('tr');
    for (let k = 0; k < columns; k += 1) row.append(document.createElement('td'));
    if (make) make(row, body.children.length);
    body.append(row);
  }
}

function makeJog(row, coordinate) {
  for (const up of [false, true]) {
    const button = document.createElement('button');
    button.className = 'jog';
    button.textContent = up ? '+' : '\u2212';
    button.dataset.coordinate = coordinate;
    button.dataset.up = up;
    button.onpointerdown = event => {
      if (event.button !== 0) return;
      event.preventDefault();
      button.setPointerCapture(event.pointerId);
      beginJog(button, coordinate, up);
    };
    for (const end of ['pointerup', 'pointercancel', 'lostpointercapture']) {
      button.addEventListener(end, endJog);
    }
    button.oncontextmenu = event => event.preventDefault();
    row.lastChild.append(button);
  }
}

function beginJog(button, coordinate, up) {
  endJog();
  send({ command: 'jog', coordinate, up, repeat: false });
  button.classList.add('held');
  const timer = setInterval(
    () => send({ command: 'jog', coordinate, up, repeat: true }), REPEAT_MS);
  held = { button, timer };
}

function endJog() {
  if (!held) return;
  clearInterval(held.timer);
  held.button.classList.remove('held');
  held = null;
  send({ command: 'jog-end' });
}

function showState(message) {
  const first = state === null;
  state = message;
  newest = message.t;
  document.body.classList.toggle('old', !message.ready || message.age_ms > 500);
  at('machine').textContent = message.machine;
  document.title = `${message.state || 'no link'} - ${message.machine}`;
  const name = message.ready ? message.state || 'waiting for telemetry' : message.link;
  at('state').textContent = name + (message.stopping ? `, ${message.stopping} requested` : '')
    + (message.fault ? `: ${message.fault}` : '');
  at('state').className = 'state ' + (message.fault || !message.ready || /fault|emergency/i.test(name)
    ? 'bad' : /hold/i.test(name) ? 'hold' : /running|jog|homing/i.test(name) ? 'moving' : '');
  at('unreferenced').hidden = message.referenced;
  const mark = message.referenced ? '' : ' ?';
  const pose = at('pose').tBodies[0];
  rows(pose, message.pose.length, 5, makeJog);
  message.pose.forEach((axis, k) => cells(pose.children[k],
    [axis.name, number(axis.commanded, 4) + mark, number(axis.actual, 4) + mark, axis.unit]));
  const joints = at('joints').tBodies[0];
  rows(joints, message.joints.length, 3);
  message.joints.forEach((joint, k) => cells(joints.children[k],
    [`joint ${joint.name}`, number(joint.actual, 4) + mark, joint.unit]));
  at('rate').textContent = `${message.jog.rate} mm/s, deg/s`;
  at('feed').textContent = number(message.feed_mm_min, 0);
  at('override').textContent = message.override;
  ['feed', 'rapid', 'spindle'].forEach((name, k) => {
    const slider = at(`override-${name}`);
    if (document.activeElement !== slider) slider.value = message.overrides[k];
    slider.nextElementSibling.textContent = `${message.overrides[k]} %`;
  });
  at('spindle').textContent = message.spindle_rpm === null ? '-' : message.spindle_rpm;
  const program = message.program;
  at('line').textContent = program
    ? `${program.name}, line ${program.line} of ${program.lines}, ${clock(program.left_s)} left: ${program.text}`
    : message.planning ? 'planning the path' : message.selected ? `selected: ${message.selected}` : '';
  if (document.activeElement !== at('programs')) at('programs').value = message.selected || '';
  showBar('question', message.question);
  showBar('problems', message.problems && message.problems.join('\n'));
  showMessages(message.messages);
  showOffsets(message);
  showTip(message);
  if (first) enableButtons();
}

// Origins of the chosen work coordinate system, and the position of the tool in it.
function showOffsets(message) {
  const root = at('offsets');
  const offsets = message.offsets;
  const why = offsets && offsets.error;
  root.querySelector('.warning').hidden = !why;
  root.querySelector('.warning').textContent = why || '';
  root.querySelector('table').hidden = !!why;
  root.querySelector('.row').hidden = !!why;
  if (!offsets || why) return;
  const list = at('system');
  if (!list.options.length) list.replaceChildren(...SYSTEMS.map(name => new Option(name, name)));
  // The message has those that are not zero.
  const system = offsets.systems.find(one => one.name === list.value)
    || { origin: offsets.letters.map(() => 0), rotation: 0 };
  at('rotation').textContent = system.rotation ? `turned by ${system.rotation} deg` : '';
  const body = root.querySelector('tbody');
  rows(body, offsets.letters.length, 4, (row, axis) => {
    const button = document.createElement('button');
    button.className = 'zero';
    button.textContent = 'zero here';
    button.onclick = () => send({ command: 'zero',
      text: `${list.value.toLowerCase()} ${state.offsets.letters[axis]}=0` });
    row.lastChild.append(button);
    button.disabled = !commands();
  });
  offsets.letters.forEach((letter, k) => {
    const axis = message.pose[k];
    const here = message.referenced && !system.rotation && axis && axis.actual !== null
      ? axis.actual - system.origin[k] : null;
    cells(body.children[k], [letter, number(system.origin[k], 4), number(here, 4)]);
  });
}

// Minutes and seconds.
function clock(seconds) {
  const whole = Math.ceil(seconds);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, '0')}`;
}

function showBar(id, text) {
  at(id).hidden = !text;
  if (text) at(id).firstElementChild.textContent = text;
}

function showMessages(messages) {
  const text = JSON.stringify(messages);
  if (showMessages.last === text) return;
  showMessages.last = text;
  at('messages').replaceChildren(...messages.slice().reverse().map(entry => {
    const row = document.createElement('li');
    row.className = `l${entry.level}`;
    row.textContent = `${entry.s} s  ${entry.text}${entry.times > 1 ? ` (${entry.times} times)` : ''}`;
    return row;
  }));
}

function showTip(message) {
  plot(message);
  if (!view) return;
  view.setMarker(message.referenced ? message.tip : null);
  showMachine(message);
  const running = message.program !== null;
  if (running && !wasRunning) done = [];
  wasRunning = running;
  if (!running || !message.tip) return;
  done.push(...message.tip);
  if (done.length > 3 * MOST_DONE) {
    done = done.filter((_, k) => Math.floor(k / 3) % 2 === 0);
  }
  const now = performance.now();
  if (done.length >= 6 && now - drawn > 250) {
    drawn = now;
    view.setLayer({ kind: 'lines', name: 'done', colour: '#d55e00', width: 3, points: done });
  }
}

// The machine of the state. The view shows the whole machine until a path is chosen.
const machine = {};
function showMachine(message) {
  let grows = false;
  for (const [name, layer] of Object.entries(window.HaptimillMachine.layers(message))) {
    if (!layer) {
      if (machine[name]) view.removeLayer(name);
      delete machine[name];
    } else if (machine[name] !== layer.key) {
      grows = grows || !(name in machine) && name !== 'force';
      machine[name] = layer.key;
      view.setLayer(layer.make());
    }
  }
  if (grows) view.refit();
}

// The surface of the stock, coloured by depth, on a block.
let stock = null;
// Height of the block below the deepest point, mm.
const BLOCK_MM = 5;
function showStock(message) {
  const { columns, rows: count, heights, depths } = message;
  // The surface before the cut.
  const blank = heights.map((height, k) => height + depths[k]);
  const triangles = [];
  for (let row = 1; row < count; row += 1) {
    for (let column = 1; column < columns; column += 1) {
      const here = row * columns + column;
      triangles.push(here, here - 1, here - columns, here - 1, here - columns - 1,
        here - columns);
    }
  }
  // The sides: strips from the border of the surface down to the floor.
  const border = [];
  for (let k = 0; k < columns; k += 1) border.push(k);
  for (let k = 1; k < count; k += 1) border.push(k * columns + columns - 1);
  for (let k = columns - 2; k >= 0; k -= 1) border.push((count - 1) * columns + k);
  for (let k = count - 2; k > 0; k -= 1) border.push(k * columns);
  border.forEach((here, k) => {
    const [floor, end] = [heights.length + k, heights.length + (k + 1) % border.length];
    const next = border[(k + 1) % border.length];
    triangles.push(here, floor, next, next, floor, end);
  });
  const floor = Math.min(...heights) - BLOCK_MM;
  stock = Object.assign({ blank, triangles, border, floor }, message);
  drawStock();
}

function showStockPart(message) {
  if (!stock) return;
  for (const [first, ...heights] of message.runs) {
    heights.forEach((height, k) => { stock.heights[first + k] = height; });
  }
  drawStock();
}

function drawStock() {
  if (!view) return;
  const { columns, rows: count, heights, blank, triangles, border, x, y } = stock;
  const total = heights.length + border.length;
  const [points, values] = [new Float32Array(3 * total), new Float32Array(total)];
  let [deepest, lowest] = [0.1, Infinity];
  heights.forEach((height, k) => {
    points[3 * k] = x[0] + (x[1] - x[0]) * (k % columns) / (columns - 1 || 1);
    points[3 * k + 1] = y[0] + (y[1] - y[0]) * Math.floor(k / columns) / (count - 1 || 1);
    points[3 * k + 2] = height;
    values[k] = blank[k] - height;
    deepest = Math.max(deepest, values[k]);
    lowest = Math.min(lowest, height);
  });
  // A cut deeper than the block makes it higher.
  stock.floor = Math.min(stock.floor, lowest);
  border.forEach((of, k) => {
    const at = 3 * (heights.length + k);
    points.set([points[3 * of], points[3 * of + 1], stock.floor], at);
  });
  view.setLayer({ kind: 'mesh', name: 'stock', opacity: 1, points, triangles, values,
    scale: { label: 'depth of cut, mm', low: 0, high: deepest, map: 'sequential' } });
  if (!showStock.seen) view.refit();
  showStock.seen = true;
}

// The last minute of the chosen values.
const trace = [];
function plot(message) {
  const values = { 'feed, mm/min': message.feed_mm_min, 'spindle, rev/min': message.spindle_rpm };
  for (const axis of message.pose) {
    values[`${axis.name} commanded, ${axis.unit}`] = axis.commanded;
    values[`${axis.name} actual, ${axis.unit}`] = axis.actual;
  }
  for (const joint of message.joints) values[`joint ${joint.name}, ${joint.unit}`] = joint.actual;
  Object.assign(values, message.columns);
  trace.push({ t: message.t / 1000, values });
  while (trace.length && trace[0].t < trace[trace.length - 1].t - PLOT_S) trace.shift();
  const list = at('columns');
  const names = Object.keys(values);
  if (list.dataset.names !== names.join()) {
    const chosen = new Set(list.dataset.names ? [...list.selectedOptions].map(o => o.value)
      : names.slice(0, 1));
    list.dataset.names = names.join();
    list.replaceChildren(...names.map(name => new Option(name, name, false, chosen.has(name))));
  }
  const now = performance.now();
  if (now - (plot.drawn || 0) < 100) return;
  plot.drawn = now;
  const canvas = at('plot');
  const ratio = window.devicePixelRatio || 1;
  const [w, h] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = w * ratio;
  canvas.height = h * ratio;
  const pen = canvas.getContext('2d');
  pen.scale(ratio, ratio);
  pen.font = '11px system-ui,sans-serif';
  const shown = [...list.selectedOptions].slice(0, COLOURS.length);
  // The lines leave room for their labels.
  const top = 18 + 14 * (shown.length - 1);
  shown.forEach((option, k) => {
    const series = trace.map(({ t, values: v }) => [t, v[option.value]])
      .filter(([, value]) => typeof value === 'number');
    if (!series.length) return;
    const all = series.map(([, value]) => value);
    let [low, high] = [Math.min(...all), Math.max(...all)];
    if (high - low < 1e-6) { low -= 0.5; high += 0.5; }
    const last = trace[trace.length - 1].t;
    pen.strokeStyle = pen.fillStyle = COLOURS[k];
    pen.lineWidth = 1.5;
    pen.beginPath();
    series.forEach(([t, value], j) => {
      const x = w * (1 - (last - t) / PLOT_S);
      const y = h - 4 - (h - 4 - top) * (value - low) / (high - low);
      if (j) pen.lineTo(x, y); else pen.moveTo(x, y);
    });
    pen.stroke();
    pen.fillText(`${option.value}: ${number(all[all.length - 1], 3)} (${number(low, 3)} to ${number(high, 3)})`,
      6, 12 + 14 * k);
  });
}

function upload(file, replace) {
  if (file.size > LONGEST) {
    say(`${file.name} has ${file.size} bytes, more than ${LONGEST}; split it`);
    return;
  }
  const names = [...at('programs').options].map(option => option.value);
  if (!replace && names.includes(file.name)) {
    if (!confirm(`${file.name} exists. Replace it?`)) return;
    replace = true;
  }
  file.text().then(text => send({ command: 'upload', name: file.name, text, replace: !!replace }));
}

at('hold').onclick = () => { endJog(); send({ command: 'hold' }); };
at('stop').onclick = () => { endJog(); send({ command: 'stop' }); };
at('emergency').onclick = () => { endJog(); send({ command: 'emergency-stop' }); };
at('take').onclick = () => send({ command: 'take' });
at('ask').querySelector('.yes').onclick = () => send({ command: 'hand-over' });
at('ask').querySelector('.no').onclick = () => send({ command: 'keep' });
at('question').querySelector('.yes').onclick = () => send({ command: 'answer', yes: true });
at('question').querySelector('.no').onclick = () => send({ command: 'answer', yes: false });
at('problems').querySelector('.no').onclick = () => send({ command: 'answer', yes: false });
for (const button of document.querySelectorAll('[data-command]')) {
  button.onclick = () => send({ command: button.dataset.command });
}
at('slower').onclick = () => send({ command: 'jog-rate', more: false });
at('faster').onclick = () => send({ command: 'jog-rate', more: true });
for (const slider of document.querySelectorAll('.percent')) {
  slider.onchange = event => {
    send({ command: 'override', of: slider.dataset.of, percent: Number(event.target.value) });
    event.target.blur();
  };
}
at('programs').onchange = event => {
  if (event.target.value) send({ command: 'select', name: event.target.value });
  event.target.blur();
};
at('run').onclick = () => send({ command: 'run' });
at('file').onchange = event => {
  if (event.target.files[0]) upload(event.target.files[0], false);
  event.target.value = '';
};
window.addEventListener('blur', endJog);
document.addEventListener('visibilitychange', () => { if (document.hidden) endJog(); });
window.addEventListener('pagehide', endJog);

// Whether pictures are drawn without a graphics card: smooth edges take most of their time then.
function drawsBySoftware() {
  const gl = document.createElement('canvas').getContext('webgl2');
  if (!gl) return false;
  const names = gl.getExtension('WEBGL_debug_renderer_info');
  const renderer = gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(renderer);
}

try {
  view = window.HaptimillViewer.create(at('view'),
    { layers: [], height: 600, smooth: !drawsBySoftware() });
  // For tests of picture and plot.
  window.haptimillView = view;
  window.haptimillPlot = () => trace;
} catch (error) {
  at('view').textContent = `no 3D view: ${error.message}`;
}
connect();
})();
