// The live view; `haptimill-web` has the messages.
'use strict';
(() => {
const at = id => document.getElementById(id);
const token = new URLSearchParams(location.hash.slice(1)).get('token');
const LONGEST = 8 * 1024 * 1024;
// A jog button repeats its press four times within the shortest usual dead-man time, 200 ms.
const REPEAT_MS = 50;
// Points of the done path at most; beyond, every second one is left out.
const MOST_DONE = 20000;

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

function send(order) {
  if (socket && socket.readyState === WebSocket.OPEN) {
    socket.send(JSON.stringify(Object.assign({ t: newest }, order)));
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
    ({ state: showState, scene: showScene, control: showControl, programs: showPrograms,
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
  at('control').textContent = `viewer ${message.you} of ${message.viewers}: `
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
    '[data-order], .jog, #run, #file, #percent, #programs, #slower, #faster, #question button, '
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
  view.fit();
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

function makeJog(row, axis) {
  for (const up of [false, true]) {
    const button = document.createElement('button');
    button.className = 'jog';
    button.textContent = up ? '+' : '\u2212';
    button.dataset.axis = axis;
    button.dataset.up = up;
    button.onpointerdown = event => {
      if (event.button !== 0) return;
      event.preventDefault();
      button.setPointerCapture(event.pointerId);
      beginJog(button, axis, up);
    };
    for (const end of ['pointerup', 'pointercancel', 'lostpointercapture']) {
      button.addEventListener(end, endJog);
    }
    button.oncontextmenu = event => event.preventDefault();
    row.lastChild.append(button);
  }
}

function beginJog(button, axis, up) {
  endJog();
  send({ order: 'jog', axis, up, repeat: false });
  button.classList.add('held');
  const timer = setInterval(() => send({ order: 'jog', axis, up, repeat: true }), REPEAT_MS);
  held = { button, timer };
}

function endJog() {
  if (!held) return;
  clearInterval(held.timer);
  held.button.classList.remove('held');
  held = null;
  send({ order: 'jog-end' });
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
  if (document.activeElement !== at('percent')) at('percent').value = message.override;
  at('spindle').textContent = message.spindle_rpm === null ? '-' : message.spindle_rpm;
  const program = message.program;
  at('line').textContent = program
    ? `${program.name}, line ${program.line} of ${program.lines}: ${program.text}`
    : message.planning ? 'planning the path' : message.selected ? `selected: ${message.selected}` : '';
  if (document.activeElement !== at('programs')) at('programs').value = message.selected || '';
  showBar('question', message.question);
  showBar('problems', message.problems && message.problems.join('\n'));
  showMessages(message.messages);
  showTip(message);
  if (first) enableButtons();
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
  if (!view) return;
  view.setMarker(message.referenced ? message.tip : null);
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
  file.text().then(text => send({ order: 'upload', name: file.name, text, replace: !!replace }));
}

at('hold').onclick = () => { endJog(); send({ order: 'hold' }); };
at('stop').onclick = () => { endJog(); send({ order: 'stop' }); };
at('emergency').onclick = () => { endJog(); send({ order: 'emergency-stop' }); };
at('take').onclick = () => send({ order: 'take' });
at('ask').querySelector('.yes').onclick = () => send({ order: 'hand-over' });
at('ask').querySelector('.no').onclick = () => send({ order: 'keep' });
at('question').querySelector('.yes').onclick = () => send({ order: 'answer', yes: true });
at('question').querySelector('.no').onclick = () => send({ order: 'answer', yes: false });
at('problems').querySelector('.no').onclick = () => send({ order: 'answer', yes: false });
for (const button of document.querySelectorAll('[data-order]')) {
  button.onclick = () => send({ order: button.dataset.order });
}
at('slower').onclick = () => send({ order: 'jog-rate', more: false });
at('faster').onclick = () => send({ order: 'jog-rate', more: true });
at('percent').onchange = event => {
  send({ order: 'override', percent: Number(event.target.value) });
  event.target.blur();
};
at('programs').onchange = event => {
  if (event.target.value) send({ order: 'select', name: event.target.value });
  event.target.blur();
};
at('run').onclick = () => send({ order: 'run' });
at('file').onchange = event => {
  if (event.target.files[0]) upload(event.target.files[0], false);
  event.target.value = '';
};
window.addEventListener('blur', endJog);
document.addEventListener('visibilitychange', () => { if (document.hidden) endJog(); });
window.addEventListener('pagehide', endJog);

try {
  view = window.HaptimillViewer.create(at('view'), { layers: [], height: 600 });
} catch (error) {
  at('view').textContent = `no 3D view: ${error.message}`;
}
connect();
})();
