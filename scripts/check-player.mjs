#!/usr/bin/env node
// Opens a recording's HTML player in headless chromium and checks that it works.
//
//   node scripts/check-player.mjs FILE.html [SCREENSHOT.png] [--size=1280x800] [--dark] [--hash=step=40&select=3]
//
// Prints one line of JSON. Exit code 0: works; 1: does not; 2: chromium is missing or the arguments are wrong.
// The browser is driven over --remote-debugging-pipe, so no packages and no ports are needed.
import { spawn } from 'node:child_process';
import { accessSync, constants, existsSync, mkdtempSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { delimiter, join, resolve } from 'node:path';
import { pathToFileURL } from 'node:url';

const DEADLINE_MS = 120_000;
const BROWSERS = ['chromium', 'chromium-browser', 'google-chrome-stable', 'google-chrome'];

function refuse(message) {
  console.error(`check-player: ${message}`);
  process.exit(2);
}

function readArguments(argv) {
  const files = argv.filter((a) => !a.startsWith('--'));
  const options = Object.fromEntries(argv.filter((a) => a.startsWith('--')).map((a) => {
    const [, name, value] = /^--([^=]+)=?(.*)$/.exec(a);
    return [name, value];
  }));
  const unknown = Object.keys(options).find((name) => !['size', 'dark', 'hash'].includes(name));
  if (unknown) refuse(`unknown option --${unknown}`);
  if (files.length < 1 || files.length > 2) refuse('usage: check-player.mjs FILE.html [SCREENSHOT.png] [--size=WxH] [--dark] [--hash=FRAGMENT]');
  if (!existsSync(files[0])) refuse(`no such file: ${files[0]}`);
  const size = /^(\d+)x(\d+)$/.exec(options.size ?? '1280x800');
  if (!size) refuse('--size must look like 1280x800');
  return { page: resolve(files[0]), shot: files[1], width: Number(size[1]), height: Number(size[2]), dark: 'dark' in options, hash: options.hash };
}

function findBrowser() {
  const folders = (process.env.PATH ?? '').split(delimiter);
  const wanted = process.env.CHROMIUM ? [resolve(process.env.CHROMIUM)] : BROWSERS.flatMap((name) => folders.map((folder) => join(folder, name)));
  const found = wanted.find((path) => {
    try { accessSync(path, constants.X_OK); return true; } catch { return false; }
  });
  return found ?? refuse(`found no chromium (${process.env.CHROMIUM ?? BROWSERS.join(', ')}); on Debian: apt-get install chromium, or set CHROMIUM to its path`);
}

// A headless browser in its own process group, so that closing it ends all its processes.
class Browser {
  constructor(path, args) {
    this.profile = mkdtempSync(join(tmpdir(), 'check-player-'));
    this.child = spawn(path, [
      '--headless=new', '--no-sandbox', '--disable-gpu', '--disable-dev-shm-usage', '--disable-breakpad', '--disable-crash-reporter',
      '--disable-background-networking', '--no-first-run', '--hide-scrollbars', `--user-data-dir=${this.profile}`,
      '--remote-debugging-pipe', ...args, 'about:blank',
    ], { detached: true, stdio: ['ignore', 'ignore', 'ignore', 'pipe', 'pipe'] });
    this.nextId = 1;
    this.waiting = new Map();
    this.onEvent = () => {};
    this.exited = new Promise((done) => this.child.once('close', done));
    this.child.once('error', (error) => this.fail(error));
    this.child.once('exit', () => this.fail(new Error('chromium ended early')));
    this.child.stdio[3].on('error', (error) => this.fail(error));
    this.read();
  }

  fail(error) {
    for (const { reject } of this.waiting.values()) reject(error);
    this.waiting.clear();
  }

  read() {
    let buffer = '';
    this.child.stdio[4].setEncoding('utf8');
    this.child.stdio[4].on('data', (chunk) => {
      const parts = (buffer + chunk).split('\0');
      buffer = parts.pop();
      for (const part of parts) this.receive(JSON.parse(part));
    });
  }

  receive(message) {
    const waiting = this.waiting.get(message.id);
    if (!waiting) return this.onEvent(message);
    this.waiting.delete(message.id);
    if (message.error) waiting.reject(new Error(message.error.message));
    else waiting.resolve(message.result);
  }

  send(method, params = {}, sessionId) {
    const id = this.nextId++;
    return new Promise((done, reject) => {
      this.waiting.set(id, { resolve: done, reject });
      this.child.stdio[3].write(`${JSON.stringify({ id, method, params, sessionId })}\0`);
    });
  }

  kill() {
    try { process.kill(-this.child.pid, 'SIGKILL'); } catch { /* already gone */ }
  }

  async close() {
    const patience = new Promise((done) => setTimeout(done, 2000).unref());
    await Promise.race([this.send('Browser.close').then(() => this.exited).catch(() => {}), patience]);
    this.kill();
    await Promise.race([this.exited, patience]);
    rmSync(this.profile, { recursive: true, force: true, maxRetries: 5 });
  }
}

async function openPage(browser, { page, hash, dark, width, height }, errors) {
  const { targetInfos } = await browser.send('Target.getTargets');
  const { targetId } = targetInfos.find((target) => target.type === 'page');
  const { sessionId } = await browser.send('Target.attachToTarget', { targetId, flatten: true });
  const send = (method, params) => browser.send(method, params, sessionId);
  const loaded = new Promise((done) => {
    browser.onEvent = ({ method, params }) => {
      if (method === 'Page.loadEventFired') done();
      if (method === 'Runtime.exceptionThrown') errors.push(params.exceptionDetails.exception?.description ?? params.exceptionDetails.text);
      if (method === 'Runtime.consoleAPICalled' && params.type === 'error') errors.push(params.args.map((a) => a.value ?? a.description).join(' '));
      if (method === 'Log.entryAdded' && params.entry.level === 'error') errors.push(params.entry.text);
      if (method === 'Network.requestWillBeSent' && !/^(file|data|about):/.test(params.request.url)) errors.push(`external request: ${params.request.url}`);
    };
  });
  for (const domain of ['Page', 'Runtime', 'Log', 'Network']) await send(`${domain}.enable`);
  await send('Emulation.setDeviceMetricsOverride', { width, height, deviceScaleFactor: 1, mobile: width < 500 });
  await send('Emulation.setEmulatedMedia', { features: [{ name: 'prefers-color-scheme', value: dark ? 'dark' : 'light' }] });
  await send('Page.navigate', { url: pathToFileURL(page).href + (hash ? `#${hash}` : '') });
  await loaded;
  return send;
}

// Runs inside the page.
async function exercise(keepState) {
  const pause = (ms) => new Promise((done) => setTimeout(done, ms));
  const failure = document.querySelector('[role=alert]');
  if (!window.player) return { errors: [failure && !failure.hidden ? `the page says: ${failure.innerText.trim()}` : 'window.player does not exist'] };
  const { player } = window, errors = [], before = player.step;
  const expect = (ok, message) => { if (!ok) errors.push(message); };

  expect(Number.isInteger(player.steps) && player.steps > 0, `steps is ${player.steps}`);
  player.pause();
  player.seek(0);
  expect(player.step === 0, `seek(0) gave step ${player.step}`);
  player.play();
  for (let n = 0; n < 40 && player.step === 0 && player.steps > 1; n++) await pause(50);
  await pause(500);
  if (player.steps > 1) expect(player.step > 0, 'playing does not move the step forward');
  else expect(!player.playing, 'a recording of one step must not play');
  player.pause();
  expect(!player.playing, 'pause() does not pause');

  const middle = Math.floor(player.steps / 2);
  player.seek(middle);
  expect(player.step === middle, `seek(${middle}) gave step ${player.step}`);
  player.seek(1e9);
  expect(player.step === player.steps - 1, 'seek past the end does not stop at the last step');
  player.select(0);
  await pause(100);
  expect(document.getElementById('vehicle').value === '0', 'select(0) does not select vehicle 0');
  const drawn = player.frameTimes();
  expect(drawn.length > 0, 'no frame was drawn');
  const times = player.benchmark(60).slice(10).sort((a, b) => a - b);

  if (keepState) {
    player.seek(before);
    player.select(-1);
    dispatchEvent(new HashChangeEvent('hashchange'));
  } else {
    player.seek(middle);
  }
  await pause(150);
  const at = (q) => Number(times[Math.floor(q * (times.length - 1))].toFixed(2));
  return { steps: player.steps, frame_ms_median: at(0.5), frame_ms_p95: at(0.95), errors };
}

async function check(browser, options) {
  const errors = [];
  const send = await openPage(browser, options, errors);
  const { result, exceptionDetails } = await send('Runtime.evaluate', {
    expression: `(${exercise})(${Boolean(options.hash)})`, awaitPromise: true, returnByValue: true,
  });
  if (exceptionDetails) errors.push(exceptionDetails.exception?.description ?? exceptionDetails.text);
  if (options.shot) {
    const { data } = await send('Page.captureScreenshot', { format: 'png' });
    writeFileSync(options.shot, Buffer.from(data, 'base64'));
  }
  const { errors: found = [], ...measured } = result.value ?? {};
  return { steps: null, frame_ms_median: null, frame_ms_p95: null, ...measured, errors: [...errors, ...found] };
}

const options = readArguments(process.argv.slice(2));
const browser = new Browser(findBrowser(), [`--window-size=${options.width},${options.height}`]);
for (const signal of ['SIGINT', 'SIGTERM', 'SIGHUP']) process.on(signal, () => { browser.kill(); process.exit(1); });
process.on('exit', () => browser.kill());
const deadline = new Promise((_, reject) => setTimeout(() => reject(new Error(`no answer within ${DEADLINE_MS / 1000} s`)), DEADLINE_MS).unref());

let report;
try {
  report = await Promise.race([check(browser, options), deadline]);
} catch (error) {
  report = { steps: null, frame_ms_median: null, frame_ms_p95: null, errors: [error.message] };
}
await browser.close();
console.log(JSON.stringify(report));
process.exit(report.errors.length ? 1 : 0);
