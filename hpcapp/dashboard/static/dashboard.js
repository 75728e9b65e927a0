// Shows a job while it runs: news come as server-sent events, parts of the mesh one at a time.
const token = new URLSearchParams(location.search).get('token');
const at = (path) => `${path}?token=${encodeURIComponent(token)}&page=${document.body.dataset.page}`;
const element = (id) => document.getElementById(id);
const MASTER = 'master';
const COLOURS = ['#4878cf', '#6acc65', '#b47cc7', '#c4ad66', '#77bedb', '#d5875c', '#8c8c8c'];
const BAD = { lost: '#c0392b', failed: '#c0392b', refused: '#c0392b', repeated: '#e0a030' };
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
  element('stage').style.visibility = news.stage ? '' : 'hidden';
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
  for (const row of rows) {
    const line = body.insertRow();
    for (const cell of row) {
      const place = line.insertCell();
      place.textContent = cell.text ?? cell;
      if (typeof cell === 'number' || cell.text !== undefined) place.className = 'number';
      if (cell.isBad) place.classList.add('bad');
    }
  }
  table.tBodies[0].replaceWith(body);
}

function showStages() {
  const seconds = new Map();
  for (const [name, worker, begin, end] of spans) {
    if (worker === MASTER) seconds.set(name, (seconds.get(name) ?? 0) + end - begin);
  }
  fill(element('stages'), [...seconds].map(([name, s]) => [name, { text: `${s.toFixed(2)} s` }]));
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
function prepare(canvas, height) {
  const scale = window.devicePixelRatio || 1, width = canvas.clientWidth;
  canvas.style.height = `${height}px`;
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const pen = canvas.getContext('2d');
  pen.scale(scale, scale);
  pen.font = '11px system-ui, sans-serif';
  pen.fillStyle = getComputedStyle(document.body).color;
  return [pen, width];
}

const shades = new Map();
function shadeOf(name) {
  if (!shades.has(name)) shades.set(name, COLOURS[shades.size % COLOURS.length]);
  return shades.get(name);
}

function drawTimeline() {
  const workers = [...new Set(spans.map((span) => span[1]).concat(news.workers.map((w) => w[0])))]
    .filter((name) => name !== MASTER)
    .sort((a, b) => a.length - b.length || (a < b ? -1 : 1)).slice(0, 63);
  const rows = new Map([MASTER, ...workers].map((name, row) => [name, row]));
  const [pen, width] = prepare(element('timeline'), 18 * rows.size + 18);
  const left = 130, right = 8, end = Math.max(news.now, 1e-3);
  const x = (time) => left + (width - left - right) * time / end;
  for (const [name, row] of rows) pen.fillText(name.slice(0, 20), 0, 18 * row + 13);
  for (let tick = 0; tick <= 5; tick++) {
    pen.globalAlpha = 0.25;
    pen.fillRect(x(end * tick / 5), 0, 1, 18 * rows.size);
    pen.globalAlpha = 1;
    pen.textAlign = tick === 5 ? 'right' : tick ? 'center' : 'left';
    const digits = end < 50 ? 1 : 0;
    pen.fillText(`${(end * tick / 5).toFixed(digits)} s`, x(end * tick / 5), 18 * rows.size + 13);
  }
  pen.textAlign = 'left';
  for (const [name, worker, begin, until, outcome] of spans) {
    if (!rows.has(worker)) continue;
    pen.fillStyle = BAD[outcome] ?? shadeOf(name);
    const long = Math.max(1, x(until) - x(begin));
    pen.fillRect(x(begin), 18 * rows.get(worker) + 2, long, 14);
    if (long > 6.5 * name.length) {
      pen.fillStyle = '#fff';
      pen.fillText(name, x(begin) + 3, 18 * rows.get(worker) + 13);
    }
  }
  if (news.stage) {
    pen.globalAlpha = 0.45;
    pen.fillStyle = shadeOf(news.stage[0]);
    pen.fillRect(x(news.stage[3]), 2, x(end) - x(news.stage[3]), 14);
    pen.globalAlpha = 1;
  }
}

function drawThroughput() {
  const end = news.now, begin = Math.max(0, end - WINDOW_S), bins = 60;
  const step = Math.max((end - begin) / bins, 1e-6);
  const tasks = new Array(bins).fill(0), travelled = new Array(bins).fill(0);
  for (const [, worker, , until, , received, sent] of spans) {
    if (worker === MASTER || until < begin) continue;
    const bin = Math.min(bins - 1, Math.floor((until - begin) / step));
    tasks[bin] += 1 / step;
    travelled[bin] += (received + sent) / step;
  }
  const [pen, width] = prepare(element('throughput'), 70);
  const draw = (values, colour) => {
    const top = Math.max(...values, 1e-9);
    pen.strokeStyle = colour;
    pen.lineWidth = 1.5;
    pen.beginPath();
    values.forEach((value, i) => pen.lineTo(width * i / (bins - 1), 66 - 60 * value / top));
    pen.stroke();
  };
  draw(travelled, '#d5875c');
  draw(tasks, '#4878cf');
  const all = spans.filter((span) => span[1] !== MASTER);
  const sum = (column) => all.reduce((total, span) => total + span[column], 0);
  element('rates').textContent = `${all.length} tasks (blue), at most ${rate(Math.max(...tasks, 1))};`
    + ` ${bytes(sum(5) + sum(6))} travelled (orange), at most ${bytes(Math.max(...travelled))}/s`;
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
    this.viewer.setBackground(getComputedStyle(document.body).backgroundColor);
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

  /** Fetch the parts that have come, one after the other: the job's machine has other work. */
  async update(parts) {
    if (this.isBusy) return;
    this.isBusy = true;
    try {
      while (this.asked < parts()) {
        const answer = await fetch(at(`parts/${this.asked}`));
        this.asked += 1;
        if (answer.ok) this.add(await answer.arrayBuffer());
      }
    } catch {
      // the server has gone: what is drawn stays
    } finally {
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
    if (!this.isTurned) this.viewer.look();
    element('empty').hidden = true;
    element('drawn').textContent = `${this.viewer.meshes.length} part${this.viewer.meshes.length > 1 ? "s" : ""}, `
      + `${this.faces.toLocaleString('en')} triangles drawn`;
  }

  /** Colour all parts, or one. */
  colour(only = null) {
    const isByPart = element('by-part').checked;
    this.viewer.meshes.forEach((mesh, part) => {
      if (only !== null && part !== only) return;
      const shade = COLOURS[part % COLOURS.length];
      const rgb = [1, 3, 5].map((place) => parseInt(shade.slice(place, place + 2), 16));
      this.viewer.colour(mesh, isByPart
        ? (_, out) => { [out[0], out[1], out[2]] = rgb; } : null);
    });
  }
}

let mesh = null;
import('hpcapp/viewer.js').then(({ Viewer }) => {
  mesh = new Mesh(Viewer);
  mesh.update(() => news.parts ?? 0);
}).catch((error) => { element('failure').textContent = `The mesh cannot be drawn: ${error.message}`; });

const source = new EventSource(at('events'));
source.addEventListener('message', (event) => {
  news = JSON.parse(event.data);
  if (news.first) { spans = []; lines = []; }
  spans.push(...news.spans);
  showLines(news.lines);
  if (!news.more) show();
  mesh?.update(() => news.parts);
  if (news.state !== 'running' && !news.more) source.close();
});
source.addEventListener('error', () => showState('cut off'));
window.addEventListener('resize', () => { if (news.workers) show(); });
