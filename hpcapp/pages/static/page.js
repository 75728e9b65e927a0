// Decodes what a page holds, and joins its controls to the viewer.
import { BACK_CSS, Viewer } from 'hpcapp/viewer.js';
import { endAt, explainTint, legend, markGuesses, placeOf, shadeField, tint } from 'hpcapp/colours.js';
import { Frame } from 'hpcapp/frame.js';
import { Measuring } from 'hpcapp/measuring.js';
import { Cutting } from 'hpcapp/cutting/cutting.js';
import { save } from 'hpcapp/saving.js';

const TYPES = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };
const find = (id) => document.getElementById(id);

/** Return the numbers of an array in the page: see hpcapp/pages/arrays.py. */
async function readArray(id) {
  const holder = find(id);
  const { type, rows, columns } = holder.dataset;
  const bytes = await window.unpack(holder.textContent);
  holder.remove();
  const values = new TYPES[type](rows * columns), size = values.BYTES_PER_ELEMENT;
  const count = values.length;
  for (let column = 0; column < columns; column++) {
    let last = 0;
    for (let row = 0, at = column * rows; row < rows; row++, at++) {
      let step = bytes[at];
      for (let plane = 1; plane < size; plane++) step |= bytes[plane * count + at] << (8 * plane);
      last += (step >>> 1) ^ -(step & 1); // 0, -1, 1, -2, 2 ...
      if (size === 4) last |= 0;
      values[row * columns + column] = last;
    }
  }
  return values;
}

async function show(scene) {
  const viewer = new Viewer(find('view'));
  window.viewer = viewer;
  viewer.pause();
  let mesh = null, points = null;
  if (scene.mesh) {
    const [positions, indices] = await Promise.all(
      [readArray(scene.mesh.positions), readArray(scene.mesh.indices)]);
    mesh = viewer.addMesh({ ...scene.mesh, positions, indices });
  }
  if (scene.points) {
    const positions = await readArray(scene.points.positions);
    points = viewer.setPoints({ ...scene.points, positions });
    if (scene.points.colours) {
      const colours = await readArray(scene.points.colours);
      viewer.colour(points, shadeField(viewer, points, { kind: 'rgb' }, colours));
    }
    viewer.show('points', !mesh);
  }
  const dark = matchMedia('(prefers-color-scheme: dark)');
  const paint = () => viewer.setBackground(dark.matches ? '#16181d' : '#ffffff');
  dark.addEventListener('change', paint);
  paint();
  await join(viewer, scene, mesh ?? points);
}

/** Join the controls; `drawn` is what they colour. */
async function join(viewer, scene, drawn) {
  const listen = (id, event, act) => find(id)?.addEventListener(event, (e) => act(e.target));
  const values = new Map(), ends = new Map();
  const fieldOf = (name) => scene.fields.find((one) => one.name === name);
  async function valuesOf(name) {
    const { array } = fieldOf(name);
    if (array && !values.has(name)) values.set(name, readArray(array));
    return values.get(name);
  }
  const guesses = scene.tint && markGuesses(
    fieldOf(scene.tint.field), await valuesOf(scene.tint.field), scene.tint.beyond);
  async function recolour() {
    const name = find('colouring').value, field = fieldOf(name), levels = await valuesOf(name);
    if (find('colouring').value !== name) return; // another one was chosen meanwhile
    const end = ends.get(name) ?? field.high, isTinted = find('tint')?.checked;
    find('legend').replaceChildren(...legend(field, levels, end),
      ...(isTinted ? [explainTint(scene.tint.text)] : []));
    find('scale-row').hidden = find('scale-name').hidden = field.kind !== 'scale';
    if (field.kind === 'scale') find('scale-end').value = placeOf(field, end);
    const shading = shadeField(viewer, drawn, field, levels, end);
    viewer.colour(drawn, isTinted ? tint(shading, viewer.plain, guesses) : shading);
    find('legend').dataset.field = name;
  }
  listen('colouring', 'change', recolour);
  listen('tint', 'change', recolour);
  listen('scale-end', 'input', (range) => {
    const name = find('colouring').value;
    ends.set(name, endAt(fieldOf(name), Number(range.value)));
    recolour();
  });
  listen('scale-reset', 'click', () => { ends.delete(find('colouring').value); recolour(); });
  listen('show-mesh', 'change', (box) => viewer.show('meshes', box.checked));
  listen('show-points', 'change', (box) => viewer.show('points', box.checked));
  listen('show-markers', 'change', (box) => viewer.show('markers', box.checked));
  listen('wireframe', 'change', (box) => viewer.setWireframe(box.checked));
  const look = (up, isAbove) => {
    viewer.look(up, isAbove);
    if (find('backs')) find('backs').checked = viewer.hasBacks;
  };
  look(scene.up);
  if (find('backs')) find('backs-tint').style.background = BACK_CSS;
  listen('backs', 'change', (box) => viewer.setBacks(box.checked));
  listen('flat', 'change', (box) => viewer.setFlat(box.checked));
  listen('point-size', 'input', (range) => viewer.setPointSize(Number(range.value)));
  const clip = () => viewer.clip(
    find('clip-axis').value || null, Number(find('clip-at').value), find('clip-flip').checked);
  for (const id of ['clip-axis', 'clip-at', 'clip-flip']) listen(id, 'input', clip);
  listen('up', 'change', (select) => look(select.value));
  listen('reset', 'click', () => look());
  listen('picture', 'click', async () => save(await viewer.picture(), `${document.title}.png`));
  const frame = scene.origin && new Frame(scene.origin, viewer.box);
  const measuring = new Measuring(viewer, find('measure'), find('measured'), frame, scene);
  if (scene.cutting && drawn) {
    const { pieces } = scene.cutting, ranks = pieces && await readArray(pieces.ranks);
    new Cutting(viewer, scene,
      { mesh: drawn, ranks, frame, measuring, look: (isAbove) => look(undefined, isAbove) });
  }
  const approach = (index) => viewer.approach(scene.markers[index].place);
  viewer.setMarkers(scene.markers, (index) => {
    approach(index);
    const item = document.querySelector(`[data-marker="${index}"]`);
    item?.scrollIntoView({ block: 'center' });
    item?.focus();
  });
  for (const item of document.querySelectorAll('[data-marker]')) {
    item.addEventListener('click', () => approach(Number(item.dataset.marker)));
  }
  if (find('colouring')) await recolour();
  viewer.resume();
}

try {
  await show(JSON.parse(find('scene').textContent));
  document.body.dataset.state = 'ready';
  requestAnimationFrame(() => find('loading').remove()); // behind the first frame
} catch (error) {
  document.body.dataset.state = 'failed';
  find('loading')?.remove();
  find('failure').textContent = `Nothing can be drawn here: ${error.message}. `
    + 'A browser with WebGL 2 shows the mesh; `hpcapp view MESH --png FILE` draws it without one.';
  throw error;
}
