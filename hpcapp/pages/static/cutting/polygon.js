// A polygon drawn from above: what lies above and below it, along z, is kept.
import * as THREE from 'three';
import { onPlane } from 'hpcapp/cutting/handles.js';
import { MOST_CORNERS } from 'hpcapp/cutting/kept.js';
import { sayNumber } from 'hpcapp/numbers.js';

const ASKED = ['three corners or more', 'two more corners', 'one more corner'];
const UP = new THREE.Vector3(0, 0, 1);

export class PolygonCut {
  constructor({ viewer, frame, kept, handles, unit, onChange }, name, crs) {
    Object.assign(this, { viewer, frame, kept, handles, unit, onChange, name, crs });
    this.corners = []; // THREE.Vector3, where they were seen
    this.line = null;
  }

  start() { this.#change(); }

  stop() {
    this.#drop();
    this.handles.set([]);
  }

  /** Add a corner where a pointer is, on what is seen there or beside it. */
  add(clientX, clientY) {
    if (this.corners.length >= MOST_CORNERS) return;
    const middle = this.viewer.box.getCenter(new THREE.Vector3());
    const place = this.viewer.pick(clientX, clientY)
      ?? onPlane(this.viewer.ray(clientX, clientY), middle, UP)?.toArray();
    if (place) this.corners.push(this.#round(new THREE.Vector3(...place)));
    this.#change();
  }

  undo() { this.corners.pop(); this.#change(); }

  /** Whether it holds something, and its sides do not cross. */
  get isDrawn() { return this.corners.length > 2 && this.#area() !== 0 && !crosses(this.corners); }

  get option() { return this.isDrawn ? `--polygon ${this.name}` : null; }

  get said() {
    const count = this.corners.length;
    if (count < 3) return `Tap ${ASKED[count]}.`;
    if (!this.isDrawn) return 'Its sides cross: drag a corner, or take one back.';
    const area = sayNumber(Math.abs(this.#area()), this.unit ? `${this.unit}²` : 'squared units');
    return `${count} corners, ${area}. Save it where the command is to run.`;
  }

  /** The polygon as GeoJSON: counterclockwise, in the coordinates of the file. */
  get geojson() {
    const ring = this.corners.map(({ x, y }) => [this.frame.world(x, 0), this.frame.world(y, 1)]);
    if (this.#area() < 0) ring.reverse();
    const geometry = { type: 'Polygon', coordinates: [[...ring, ring[0]]] };
    return JSON.stringify({
      type: 'FeatureCollection',
      ...(this.crs && { crs: this.crs }),
      features: [{ type: 'Feature', properties: {}, geometry }],
    });
  }

  #round(place) {
    return place.setX(this.frame.local(place.x, 0)).setY(this.frame.local(place.y, 1));
  }

  #area() {
    return this.corners.reduce((sum, { x, y }, k) => {
      const from = this.corners.at(k - 1);
      return sum + 0.5 * (from.x * y - x * from.y);
    }, 0);
  }

  #change() {
    this.handles.set(this.corners.map((corner) => ({
      place: () => corner,
      drag: (ray) => {
        const place = onPlane(ray, corner, UP);
        if (place) this.#round(corner.copy(place));
        this.#show();
      },
    })));
    this.#show();
  }

  #show() {
    this.#drop();
    const isClosed = this.corners.length > 2;
    this.line = new (isClosed ? THREE.LineLoop : THREE.Line)(
      new THREE.BufferGeometry().setFromPoints(this.corners),
      new THREE.LineBasicMaterial({ color: this.viewer.accent, depthTest: false }));
    this.line.frustumCulled = false;
    this.viewer.scene.add(this.line);
    if (this.isDrawn) this.kept.polygon(this.corners.map(({ x, y }) => [x, y]));
    else this.kept.all();
    this.onChange();
  }

  #drop() {
    if (!this.line) return;
    this.viewer.scene.remove(this.line);
    this.line.geometry.dispose();
    this.line.material.dispose();
    this.line = null;
  }
}

/** On which side of a line from a to b a place lies: 1, -1, or 0 on it. */
const sideOf = (a, b, c) => Math.sign((b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x));

/** Whether a place on the line through two others lies between them. */
const isBetween = (a, b, c) => sideOf(a, b, c) === 0
  && Math.min(a.x, b.x) <= c.x && c.x <= Math.max(a.x, b.x)
  && Math.min(a.y, b.y) <= c.y && c.y <= Math.max(a.y, b.y);

/** Whether two sides of a ring meet elsewhere than in the corner that neighbours share. */
export function crosses(corners) {
  const count = corners.length;
  const side = (k) => [corners[k], corners[(k + 1) % count]];
  for (let i = 0; i < count; i++) {
    const [a, b] = side(i), next = side((i + 1) % count);
    if (isBetween(a, b, next[1]) || isBetween(...next, a)) return true; // back on itself
    for (let j = i + 2; j < count; j++) {
      if (i === 0 && j === count - 1) continue;
      const [c, d] = side(j);
      if (sideOf(a, b, c) !== sideOf(a, b, d) && sideOf(c, d, a) !== sideOf(c, d, b)) return true;
      if ([c, d].some((end) => isBetween(a, b, end)) || isBetween(c, d, a)) return true;
    }
  }
  return false;
}
