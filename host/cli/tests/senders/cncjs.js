// Homes the machine behind a pseudo-terminal and sends a program with cncjs, without a browser.
//
// Usage: node cncjs.js FOLDER PTY PROGRAM PORT; FOLDER has node_modules with cncjs. Exit code 0 when
// the whole program was acknowledged without an error and the machine stands still.
'use strict';
const { spawn } = require('child_process');
const fs = require('fs');
const path = require('path');
const [folder, pty, program, port] = process.argv.slice(2);
const modules = path.join(folder, 'node_modules');
const io = require(path.join(modules, 'socket.io-client'));
const jwt = require(path.join(modules, 'jsonwebtoken'));

const LIMIT_MS = 120000;
// Where job.ngc ends, mm.
const END = [-3, 2, 47.5];
const config = path.join(folder, 'cncrc.json');
const secret = 'a secret of this test';
fs.writeFileSync(config, JSON.stringify({ secret, state: { checkForUpdates: false } }));
const server = spawn(process.execPath,
  [path.join(modules, 'cncjs/bin/cncjs'), '--config', config, '--port', port, '--host', '127.0.0.1'],
  { stdio: 'ignore' });
const end = (code, text) => {
  console.log(text);
  server.kill();
  process.exit(code);
};
setTimeout(() => end(1, `no end of the job within ${LIMIT_MS} ms: ${mode} ${stage}`), LIMIT_MS);

let mode = '', stage = 'connect', acknowledged = false, position = null;
const token = jwt.sign({ id: '', name: 'test' }, secret, { expiresIn: '1h' });
const connect = () => {
  const socket = io(`ws://127.0.0.1:${port}`, { query: `token=${token}` });
  socket.on('connect', () => {
    if (stage !== 'connect') return;
    stage = 'open';
    socket.emit('open', pty, { controllerType: 'Grbl', baudrate: 115200 });
  });
  socket.on('serialport:error', error => end(1, `serial port: ${JSON.stringify(error)}`));
  socket.on('serialport:read', line => {
    if (/^(error|ALARM):/.test(line) && (stage === 'job' || stage === 'run')) end(1, line);
  });
  socket.on('sender:status', status => {
    acknowledged = status.total > 0 && status.received === status.total;
  });
  socket.on('controller:state', (kind, state) => {
    if (kind !== 'Grbl') return;
    mode = state.status.activeState;
    position = state.status.mpos;
    if (stage === 'open' && mode === 'Alarm') {
      stage = 'homing';
      socket.emit('command', pty, 'homing');
    } else if (stage === 'homing' && mode === 'Idle') {
      stage = 'job';
      const text = fs.readFileSync(program, 'ascii');
      socket.emit('command', pty, 'gcode:load', 'job.ngc', text, {}, () => {
        socket.emit('command', pty, 'gcode:start');
      });
    } else if (stage === 'job' && mode === 'Run') {
      stage = 'run';
    } else if (stage === 'run' && acknowledged && mode === 'Idle') {
      const wrong = ['x', 'y', 'z'].some((axis, k) => Math.abs(position[axis] - END[k]) > 0.001);
      end(wrong ? 1 : 0, `machine position ${position.x} ${position.y} ${position.z}`);
    }
  });
};
setTimeout(connect, 4000);
