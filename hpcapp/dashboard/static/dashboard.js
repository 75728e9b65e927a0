// Shows a job while it runs: news come as server-sent events, parts of the mesh one at a time.
const token = new URLSearchParams(location.search).get('token');
const at = (path) => `${path}?token=${encodeURIComponent(token)}&page=${document.body.dataset.page}`;
const element = (id) => document.getElementById(id);
const MASTER = 'master';
const SERIES = 8; // colours of the design
const BAD = { lost: '--failed', failed: '--failed', refused: '--failed', repeated: '--warn' };
const WINDOW_S = 60; // of the throughput
const MOST_LINES = 500;

let news = {};
let spans = [];
let lines = [];

// -- numbers for people ---------------------------------------------------------------------------
function bytes(count) {
  const units = ['B', 'kB', 'MB', 'GB', 'TB'];
  let unit = 0;
  while (count >= 1000 && unit < 4) { count /= 1000; unit += 1; }
  return `${count.toFixed(unit && count < 100 ? 1 : 0)} ${units[unit]}`;
}

function duration(seconds) {
  const two = (number) => String(number).padStart(2, '0');
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)}:${two(whole % 60)} min`;
  return `${Math.floor(whole / 3600)}:${two(Math.floor(whole % 3600 / 60))} h`;
}

const rate = (speed) => (speed < 1 ? `${(1 / speed).toFixed(1)} s each` : `${speed.toFixed(1)}/s`);

// -- the page -------------------------------------------------------------------------------------
function showState(state) {
  element('state').textContent = state;
  element('state').className = state.split(' ')[0];
}

function showStage() {
  const bar = element('bar');
  element('stage').hidden = news.state !== 'running';
  element('stage').style.visibility = news.stage ? '' : 'hidden'; // between two: nothing jumps
  if (!news.stage) return;
  const [name, done, total, begin] = news.stage;
  element('stage-name').textContent = name;
  if (total) bar.value = done / total; else bar.removeAttribute('value');
  const passed = news.now - begin;
  const said = [duration(passed)];
  if (total) said.unshift(`${done} of ${total}`);
  if (done) said.push(rate(done / passed));
  if (done && done < total) said.push(`${duration(passed / done * (total - done))} left`);
  element('stage-rate').textContent = said.join(' · ');
}

function fill(table, rows) {
  const body = document.createElement('tbody');
  const names = [...table.tHead.rows[0].cells].map((cell) => cell.textContent);
  for (const row of rows) {
    const line = body.insertRow();
    row.forEach((cell, column) => {
      const place = line.insertCell();
      place.textContent = cell.text ?? cell;
      place.dataset.name = names[column];
      if (typeof cell === 'number' || cell.text !== undefined) place.className = 'number';
      if (cell.isBad) place.classList.add('bad');
      if (cell.text === 0) place.classList.add('none');
    });
  }
  table.tBodies[0].replaceWith(body);
}

/** Fill a list: each item is a sequence of elements and words. */
function list(element, items) {
  element.replaceChildren(...items.map((parts) => {
    const item = document.createElement('li');
    item.append(...parts);
    return item;
  }));
}

function bold(text) {
  const element = document.createElement('b');
  element.textContent = text;
  return element;
}

function showStages() {
  const seconds = new Map();
  for (const [name, worker, begin, end] of spans) {
    if (worker === MASTER) seconds.set(name, (seconds.get(name) ?? 0) + end - begin);
  }
  list(element('stages'), [...seconds].map(([name, s]) => [`${name} `, bold(`${s.toFixed(2)} s`)]));
}

function showWorkers() {
  const found = new Map();
  const of = (name) => {
    if (!found.has(name)) {
      found.set(name, { now: '', tasks: 0, busy: 0, received: 0, sent: 0, lost: 0, again: 0,
        first: news.now });
    }
    return found.get(name);
  };
  for (const [name, state, task] of news.workers) of(name).now = task || state;
  for (const [, worker, begin, end, outcome, received, sent] of spans) {
    if (worker === MASTER) continue;
    const row = of(worker);
    row[{ done: 'tasks', repeated: 'again' }[outcome] ?? 'lost'] += 1;
    row.busy += end - begin;
    row.received += received;
    row.sent += sent;
    row.first = Math.min(row.first, begin);
  }
  const order = (a, b) => a.length - b.length || (a < b ? -1 : 1); // worker-2 before worker-10
  fill(element('workers'), [...found.keys()].sort(order).map((name) => {
    const row = found.get(name);
    const share = row.busy / Math.max(1e-9, news.now - row.first);
    return [name, row.now, row.tasks, { text: `${Math.min(100, Math.round(100 * share))} %` },
      { text: bytes(row.received) }, { text: bytes(row.sent) },
      { text: row.again }, { text: row.lost, isBad: row.lost > 0 }];
  }));
}

// -- pictures -------------------------------------------------------------------------------------
let colours = new Map(); // of the design, as the page has them now
function colourOf(name) {
  if (!colours.has(name)) {
    colours.set(name, getComputedStyle(document.body).getPropertyValue(name).trim());
  }
  return colours.get(name);
}
const seriesOf = (number) => colourOf(`--series-${number % SERIES + 1}`);

function prepare(canvas, height) {
  const scale = window.devicePixelRatio || 1, width = canvas.clientWidth;
  canvas.style.height = `${height}px`;
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const pen = canvas.getContext('2d');
  pen.scale(scale, scale);
  pen.font = `12px ${colourOf('--sans')}`;
  pen.fillStyle = colourOf('--ink');
  return [pen, width];
}

/** A text as far as it fits. */
function fit(pen, text, width) {
  if (pen.measureText(text).width <= width) return text;
  let most = text.length;
  while (most > 1 && pen.measureText(`${text.slice(0, most)}…`).width > width) most -= 1;
  return `${text.slice(0, most)}…`;
}

/** The largest of 1, 2 or 5 times a power of ten that is not below a number. */
function roundUp(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].find((digit) => digit * power >= least * (1 - 1e-9)) * power;
}

// The tasks that took most time have a colour each, the others share the last one. Stages are grey,
// and told by their names.
function rankTasks() {
  const seconds = new Map();
  for (const [name, worker, begin, end] of spans) {
    if (worker !== MASTER) seconds.set(name, (seconds.get(name) ?? 0) + end - begin);
  }
  const names = [...seconds.keys()].sort((a, b) => seconds.get(b) - seconds.get(a));
  return new Map(names.map((name, rank) => [name, Math.min(rank, SERIES - 1)]));
}

function showKey(ranks, isSeen) {
  const dot = (colour) => {
    const element = document.createElement('i');
    element.style.background = colour;
    return element;
  };
  const items = [...ranks].slice(0, SERIES - 1).map(([name, rank]) => [dot(seriesOf(rank)), name]);
  if (ranks.size >= SERIES) items.push([dot(seriesOf(SERIES - 1)), 'other tasks']);
  if (isSeen.lost) items.push([dot(colourOf('--failed')), 'lost, failed or refused']);
  if (isSeen.repeated) items.push([dot(colourOf('--warn')), 'repeated']);
  list(element('key'), items);
}

const ROW = 20;

function drawTimeline() {
  const workers = [...new Set(spans.map((span) => span[1]).concat(news.workers.map((w) => w[0])))]
    .filter((name) => name !== MASTER)
    .sort((a, b) => a.length - b.length || (a < b ? -1 : 1)).slice(0, 63);
  const rows = new Map([MASTER, ...workers].map((name, row) => [name, row]));
  const [pen, width] = prepare(element('timeline'), ROW * (rows.size + 1));
  const label = (name) => (name === MASTER ? 'stages' : name);
  const widest = Math.max(...[...rows.keys()].map((name) => pen.measureText(label(name)).width));
  const left = Math.min(widest, 0.3 * width) + 10, right = 12, end = Math.max(news.now, 1e-3);
  const x = (time) => left + (width - left - right) * time / end;
  for (const [name, row] of rows) {
    pen.fillText(fit(pen, label(name), left - 10), 0, ROW * row + 15);
  }
  drawTicks(pen, x, end, ROW * rows.size, Math.max(1, Math.floor((width - left) / 60)));
  const ranks = rankTasks(), isSeen = { lost: false, repeated: false };
  for (const [name, worker, begin, until, outcome] of spans) {
    if (!rows.has(worker)) continue;
    const isStage = worker === MASTER, bad = BAD[outcome];
    if (bad) isSeen[outcome === 'repeated' ? 'repeated' : 'lost'] = true;
    const colour = bad ? colourOf(bad) : isStage ? colourOf('--edge') : seriesOf(ranks.get(name));
    drawBar(pen, name, colour, x(begin), x(until), ROW * rows.get(worker));
  }
  if (news.stage) drawBar(pen, news.stage[0], colourOf('--edge'), x(news.stage[3]), x(end), 0);
  showKey(ranks, isSeen);
}

function drawTicks(pen, x, end, height, most) {
  const step = roundUp(end / most), digits = Math.max(0, -Math.floor(Math.log10(step)));
  pen.textAlign = 'center';
  for (let tick = 0; tick * step <= end; tick++) {
    const at = x(tick * step), text = `${(tick * step).toFixed(digits)} s`;
    pen.fillStyle = colourOf('--line');
    pen.fillRect(at, 0, 1, height);
    const half = pen.measureText(text).width / 2; // the last one must not be cut
    pen.fillStyle = colourOf('--soft');
    pen.fillText(text, Math.min(at, x(end) + 12 - half), height + 15);
  }
  pen.textAlign = 'left';
}

function drawBar(pen, name, colour, begin, end, top) {
  const long = Math.max(1, end - begin - 0.5); // a hair's breadth between two of them
  pen.fillStyle = colour;
  pen.fillRect(begin, top + 2, long, ROW - 4);
  if (long < pen.measureText(name).width + 8) return;
  pen.fillStyle = colourOf('--paper');
  pen.fillText(name, begin + 4, top + 14.5);
}

function drawThroughput() {
  const end = news.now, begin = Math.max(0, end - WINDOW_S), bins = 60;
  const step = Math.max((end - begin) / bins, 1e-6);
  const ended = new Array(bins).fill(0), travelled = new Array(bins).fill(0);
  for (const [, worker, , until, , received, sent] of spans) {
    if (worker === MASTER || until < begin) continue;
    const bin = Math.min(bins - 1, Math.floor((until - begin) / step));
    ended[bin] += 1 / step;
    travelled[bin] += (received + sent) / step;
  }
  drawRate('tasks', ended, '--series-1');
  drawRate('bytes', travelled, '--series-2');
  const all = spans.filter((span) => span[1] !== MASTER);
  const sum = (column) => all.reduce((total, span) => total + span[column], 0);
  element('task-rate').textContent = `${all.length.toLocaleString('en')} tasks`
    + (all.length ? `, at most ${rate(Math.max(...ended, 1e-9))}` : '');
  element('byte-rate').textContent = `${bytes(sum(5) + sum(6))} travelled`
    + (all.length ? `, at most ${bytes(Math.max(...travelled))}/s` : '');
}

function drawRate(id, values, colour) {
  const height = 40, [pen, width] = prepare(element(id), height);
  const top = Math.max(...values, 1e-9);
  pen.fillStyle = colourOf('--line');
  pen.fillRect(0, height - 1, width, 1);
  pen.strokeStyle = colourOf(colour);
  pen.lineWidth = 1.5;
  pen.beginPath();
  values.forEach((value, i) => {
    pen.lineTo(width * i / (values.length - 1), height - 2 - (height - 5) * value / top);
  });
  pen.stroke();
}

function show() {
  showState(news.state);
  element('now').textContent = duration(news.now);
  showStage();
  showStages();
  showWorkers();
  drawTimeline();
  drawThroughput();
}

function showLines(fresh) {
  if (!fresh.length) return;
  lines = lines.concat(fresh).slice(-MOST_LINES);
  const log = element('log');
  const isAtEnd = log.scrollTop + log.clientHeight > log.scrollHeight - 20;
  log.textContent = lines.join('\n');
  if (isAtEnd) log.scrollTop = log.scrollHeight;
}

// -- the mesh -------------------------------------------------------------------------------------
class Mesh {
  constructor(Viewer) {
    this.viewer = new Viewer(element('view'));
    this.setBackground();
    this.asked = 0;
    this.faces = 0;
    this.isTurned = false;
    element('view').addEventListener('pointerdown', () => { this.isTurned = true; });
    element('wireframe').addEventListener('change', (event) => {
      this.viewer.setWireframe(event.target.checked);
    });
    element('by-part').addEventListener('change', () => this.colour());
    element('reset').addEventListener('click', () => { this.isTurned = false; this.viewer.look(); });
  }

  setBackground() {
    this.viewer.setBackground(getComputedStyle(document.body).backgroundColor);
  }

  /**
   * Fetch the parts that have come, one after the other: the job's machine has other work. When it
   * is over they are drawn behind the last one: its server does not wait for ever.
   */
  async update() {
    if (this.isBusy) return;
    this.isBusy = true;
    const waiting = [];
    const draw = () => waiting.splice(0).forEach((content) => this.add(content));
    try {
      while (this.asked < (news.parts ?? 0)) {
        const answer = await fetch(at(`parts/${this.asked}`));
        this.asked += 1;
        if (answer.ok) waiting.push(await answer.arrayBuffer());
        if (news.state === 'running') draw();
      }
    } catch {
      // the server has gone: what is drawn stays
    } finally {
      draw();
      if (news.state !== 'running' && !this.isTurned) this.viewer.look();
      this.isBusy = false;
    }
  }

  add(content) {
    if (!content.byteLength) return;
    const head = new DataView(content);
    const [step, ...low] = [0, 8, 16, 24].map((place) => head.getFloat64(place, true));
    const [count, faces] = [32, 36].map((place) => head.getUint32(place, true));
    const positions = new Uint16Array(content, 40, 3 * count);
    const indices = new Uint32Array(content, 40 + 4 * Math.ceil(6 * count / 4), 3 * faces);
    this.viewer.addMesh({ positions, step, low, indices });
    this.faces += faces;
    this.colour(this.viewer.meshes.length - 1);
    if (!this.isTurned) this.viewer.frame(); // a part may look like a room
    element('empty').hidden = true;
    element('drawn').textContent = `${this.viewer.meshes.length} part${this.viewer.meshes.length > 1 ? "s" : ""}, `
      + `${this.faces.toLocaleString('en')} triangles drawn`;
  }

  /** Colour all parts, or one. */
  colour(only = null) {
    const isByPart = element('by-part').checked;
    this.viewer.meshes.forEach((mesh, part) => {
      if (only !== null && part !== only) return;
      const shade = seriesOf(part);
      const rgb = [1, 3, 5].map((place) => parseInt(shade.slice(place, place + 2), 16));
      this.viewer.colour(mesh, isByPart
        ? (_, out) => { [out[0], out[1], out[2]] = rgb; } : null);
    });
  }
}

let mesh = null;
import('hpcapp/viewer.js').then(({ Viewer }) => {
  mesh = new Mesh(Viewer);
  mesh.update();
}).catch((error) => { element('failure').textContent = `The mesh cannot be drawn: ${error.message}`; });

const source = new EventSource(at('events'));
source.addEventListener('message', (event) => {
  news = JSON.parse(event.data);
  if (news.first) { spans = []; lines = []; }
  spans.push(...news.spans);
  showLines(news.lines);
  if (!news.more) show();
  mesh?.update();
  if (news.state !== 'running' && !news.more) source.close();
});
source.addEventListener('error', () => showState('cut off'));
window.addEventListener('resize', () => { if (news.workers) show(); });
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
  colours = new Map();
  mesh?.setBackground();
  mesh?.colour();
  if (news.workers) show();
});
