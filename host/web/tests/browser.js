// Operates the page of `haptimill serve` in Chromium: load, home, jog, upload, run, hold, resume,
// stop, second viewer, disconnect. Measures frames and the load of the server.
//
// Usage, at the root of the repository: node browser.js FOLDER COMMAND; FOLDER has node_modules with
// playwright-core and gets the pictures.
'use strict';
const { spawn } = require('child_process');
const fs = require('fs');
const path = require('path');
const [folder, command] = process.argv.slice(2);
const { chromium } = require(path.resolve(folder, 'node_modules', 'playwright-core'));

const LIMIT_MS = 120000;
const JOG_TIMEOUT_MS = 200;
const pictures = path.resolve(folder, 'pictures');
fs.mkdirSync(pictures, { recursive: true });
const programs = fs.mkdtempSync(path.join(require('os').tmpdir(), 'haptimill-browser-'));

const assert = (holds, what) => {
  if (!holds) throw new Error(what);
  console.log(`passed: ${what}`);
};
const sleep = ms => new Promise(done => setTimeout(done, ms));

async function serve() {
  const server = spawn(command, ['serve', '--listen', '127.0.0.1:0', '--programs', programs,
    '--stock', 'examples/block.toml'], { stdio: ['ignore', 'pipe', 'inherit'] });
  const link = await new Promise((done, fail) => {
    server.stdout.once('data', data => done(String(data).trim()));
    server.once('exit', code => fail(new Error(`haptimill serve ended with ${code}`)));
  });
  return { server, link };
}

// Processor time of a process in seconds.
function processorTime(pid) {
  const fields = fs.readFileSync(`/proc/${pid}/stat`, 'utf8').split(') ')[1].split(' ');
  return (Number(fields[11]) + Number(fields[12])) / 100;
}

// Answers a question with yes. A command to a busy server may be too old: it is given again.
async function answer({ page, seen, wait }) {
  await wait('a question', state => state.question);
  for (let tries = 0; tries < 10 && seen.state.question; tries += 1) {
    await page.click('#question .yes', { timeout: 2000 }).catch(() => {});
    for (let looks = 0; looks < 60 && seen.state.question; looks += 1) await sleep(50);
  }
  assert(!seen.state.question, 'the question was answered');
}

// The page, and what its WebSocket receives.
async function open(browser, link, size) {
  const page = await browser.newPage({ viewport: size });
  const seen = { states: 0, state: null, jogs: 0, force: 0, problems: [] };
  page.on('websocket', socket => socket.on('framereceived', ({ payload }) => {
    const message = JSON.parse(payload);
    if (message.kind !== 'state') return;
    seen.states += 1;
    seen.state = message;
    if (/jog/.test(message.state)) seen.jogs += 1;
    seen.force = Math.max(seen.force, ...(message.force || [0]).map(Math.abs));
  }));
  page.on('pageerror', error => seen.problems.push(String(error)));
  page.on('console', entry => {
    if (entry.type() === 'error') seen.problems.push(entry.text());
  });
  await page.goto(link);
  const wait = async (what, holds) => {
    const until = Date.now() + LIMIT_MS;
    while (!(seen.state && holds(seen.state))) {
      if (Date.now() > until) throw new Error(`waited for ${what}: ${JSON.stringify(seen.state)}`);
      await sleep(20);
    }
  };
  return { page, seen, wait };
}

async function run() {
  const { server, link } = await serve();
  const browser = await chromium.launch({ executablePath: process.env.CHROMIUM || '/usr/bin/chromium',
    args: ['--no-sandbox', '--enable-unsafe-swiftshader'] });
  try {
    const first = await open(browser, link, { width: 1280, height: 1000 });
    const { page, seen, wait } = first;
    await wait('the machine', state => state.ready && state.state === 'disabled');
    assert(await page.isDisabled('#run'), 'nobody commands at first');
    // The machine has no machine file, and so no work offsets.
    await page.waitForFunction(() => document.querySelector('#offsets .warning').textContent);
    const isVisible = part => page.isVisible(`#offsets ${part}`);
    assert(await isVisible('.warning'), 'the page says why there are no work offsets');
    assert(!await isVisible('.row') && !await isVisible('table'), 'and has no list of them');
    // The picture is not mirrored: in the view from above x is to the right and y up, in the first
    // view the axes are right-handed.
    const axes = () => page.evaluate(() => {
      const zero = window.haptimillView.project([0, 0, 0]);
      return [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(axis => {
        const [x, y, depth] = window.haptimillView.project(axis);
        return [x - zero[0], zero[1] - y, zero[2] - depth];
      });
    });
    const [a, b, c] = await axes();
    const determinant = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
      + a[2] * (b[0] * c[1] - b[1] * c[0]);
    assert(determinant > 0, 'the view is right-handed');
    await page.click('.hv-bar button:text-is("top")');
    const [x, y] = await axes();
    assert(x[0] > 0 && Math.abs(x[1]) < 1e-6 && y[1] > 0, 'from above x is to the right and y up');
    await page.click('.hv-bar button:text-is("3D")');
    await page.click('#take');
    await page.click('[data-command=home]');
    await answer(first);
    await wait('the home pose', state => state.referenced && state.state === 'idle'
      && state.messages.some(entry => /home pose: done/.test(entry.text)));

    // A jog lasts as long as its button is held.
    const before = seen.state.pose[0].actual;
    const plus = page.locator('.jog[data-coordinate="0"][data-up="true"]');
    await plus.hover();
    await page.mouse.down();
    await sleep(800);
    await page.mouse.up();
    await wait('the end of the jog', state => state.state === 'idle');
    assert(seen.state.pose[0].actual > before + 0.5, 'the jog moved x');

    // A closed page ends its jog, and the machine stays where it was then.
    const second = await open(browser, link, { width: 400, height: 800 });
    await second.wait('state', state => state.ready);
    await second.page.click('#take');
    await page.waitForSelector('#ask:not([hidden])');
    await page.click('#ask .yes');
    await second.page.waitForFunction(() => !document.getElementById('run').disabled);
    await second.page.locator('.jog[data-coordinate="0"][data-up="false"]').hover();
    const jogs = seen.jogs;
    await second.page.mouse.down();
    await wait('the jog of the second viewer', () => seen.jogs > jogs);
    await second.page.screenshot({ path: path.join(pictures, 'phone.png') });
    await second.page.close();
    const closed = Date.now();
    await wait('the end of its jog', state => state.state === 'idle');
    const took = Date.now() - closed;
    console.log(`a closed page: idle after ${took} ms ` +
      `(jog timeout ${JOG_TIMEOUT_MS} ms, report 50 ms)`);
    assert(took < 2000, 'the jog of a closed page ended');

    // Back to the start of the program, which cuts the stock.
    await page.click('#take');
    await page.waitForFunction(() => !document.getElementById('run').disabled);
    // The machine is idle between the search of the references and the move to the home pose.
    const homed = state => state.messages
      .reduce((sum, entry) => sum + (/home pose: done/.test(entry.text) ? entry.times : 0), 0);
    const homings = homed(seen.state);
    await page.click('[data-command=home]');
    await answer(first);
    await wait('the home pose', state => state.state === 'idle' && homed(state) > homings);
    const choose = async (name, source) => {
      await page.setInputFiles('#file',
        { name, mimeType: 'text/plain', buffer: fs.readFileSync(source) });
      await page.waitForSelector(`#programs option[value="${name}"]`, { state: 'attached' });
      assert(fs.readFileSync(path.join(programs, name)).equals(fs.readFileSync(source)),
        `${name} was uploaded`);
      await page.selectOption('#programs', name);
      await wait('its path', state => state.selected === name && !state.planning);
    };
    await choose('slot.ngc', 'examples/e7-slot.ngc');
    await page.selectOption('#columns', ['feed, mm/min', 'force z, N']);
    await page.click('#run');
    await answer(first);
    await wait('the run', state => state.program && state.feed_mm_min > 100);
    const most = await page.evaluate(() => Math.max(...window.haptimillPlot()
      .map(({ values }) => values['feed, mm/min'] || 0)));
    assert(most > 100 && most < 50 * 60 * Math.sqrt(3),
      `the plot has the feed since the start, at most ${most.toFixed(0)} mm/min`);
    const drawn = () => page.evaluate(() => window.haptimillView.drawn());
    const measure = async name => {
      // The first slow pictures make the view simpler.
      await sleep(2000);
      const [states, used, begun] = [seen.states, processorTime(server.pid), Date.now()];
      const first = await drawn();
      await sleep(5000);
      const count = await drawn() - first;
      const seconds = (Date.now() - begun) / 1000;
      console.log(`${name}: states ${((seen.states - states) / seconds).toFixed(1)} and pictures `
        + `${(count / seconds).toFixed(1)} per second, server with its simulated machine `
        + `${(100 * (processorTime(server.pid) - used) / seconds).toFixed(1)} % of one core`);
      assert(count > 0, 'the machine is drawn while it moves');
    };
    await measure('slot');
    await page.screenshot({ path: path.join(pictures, 'web.png') });
    await page.click('#hold');
    await wait('the hold', state => /hold/.test(state.state) && state.feed_mm_min === 0);
    const held = seen.state.pose[0].commanded;
    await sleep(500);
    assert(seen.state.pose[0].commanded === held, 'a hold stands still');
    assert(seen.force > 1, 'the force of the cut was reported');
    await page.click('[data-command=resume]');
    await wait('motion', state => state.program && state.feed_mm_min > 100);
    await page.click('#stop');
    await wait('standstill', state => state.state === 'idle' && !state.program);
    // Five axes, and a long path.
    await page.click('[data-command=home]');
    await answer(first);
    await wait('the home pose', state => state.state === 'idle' && homed(state) > homings + 1);
    await choose('dome.ngc', 'examples/dome.ngc');
    await page.click('#run');
    await answer(first);
    await wait('the run', state => state.program && state.feed_mm_min > 100);
    await measure('dome');
    await page.click('#stop');
    await wait('standstill', state => state.state === 'idle' && !state.program);
    const underruns = seen.state.messages.filter(entry => /periods late|underrun/i.test(entry.text));
    assert(!underruns.length, `no underrun ${underruns.map(entry => entry.text)}`);
    assert(seen.problems.length === 0, `no problem in the page ${seen.problems}`);
  } finally {
    await browser.close();
    server.kill('SIGINT');
    fs.rmSync(programs, { recursive: true });
  }
}

run().catch(error => {
  console.error(error);
  process.exit(1);
});
