// A box along the axes: its faces and corners are dragged.
import * as THREE from 'three';
import { alongAxis, onPlane } from 'hpcapp/cutting/handles.js';
import { sayNumber } from 'hpcapp/numbers.js';

const AROUND = 0.02; // of the longest side: so far around all of the file it begins
const FARTHEST = 0.1; // likewise: so far it can be dragged
const THINNEST = 0.001;

export class BoxCut {
  /** The file lies between `low` and `high` in the frame of the scene. */
  constructor({ viewer, frame, kept, handles, unit, heightScale, onChange }, { low, high }) {
    Object.assign(this, { viewer, frame, kept, handles, unit, heightScale, onChange, low, high });
    this.longest = Math.max(...high.map((end, k) => end - low[k])) || 1;
    this.box = new THREE.Box3();
    [0, 1, 2].forEach((axis) => {
      this.box.min.setComponent(axis, frame.local(low[axis] - AROUND * this.longest, axis));
      this.box.max.setComponent(axis, frame.local(high[axis] + AROUND * this.longest, axis));
    });
  }

  start() {
    this.edges = new THREE.Box3Helper(this.box, this.viewer.accent);
    this.edges.material.depthTest = false;
    this.viewer.scene.add(this.edges);
    const sides = ['min', 'max'], handles = [];
    for (const axis of [0, 1, 2]) for (const side of sides) handles.push(this.#face(axis, side));
    for (const x of sides) {
      for (const y of sides) for (const z of sides) handles.push(this.#corner([x, y, z]));
    }
    this.handles.set(handles);
    this.viewer.include(handles.map(({ place }) => place()));
    this.#change();
  }

  stop() {
    this.viewer.scene.remove(this.edges);
    this.edges.dispose();
    this.handles.set([]);
  }

  get option() {
    const ends = ['min', 'max'].flatMap((side) => (
      this.box[side].toArray().map((end, axis) => this.frame.world(end, axis))));
    return `--box ${ends.join(',')}`;
  }

  get said() {
    const size = this.box.getSize(new THREE.Vector3());
    size.z *= this.heightScale;
    const sides = size.toArray().map((side) => sayNumber(side)).join(' × ');
    return `Drag its faces and corners. It is ${sides}${this.unit && ` ${this.unit}`}.`;
  }

  #face(axis, side) {
    const place = () => this.box.getCenter(new THREE.Vector3())
      .setComponent(axis, this.box[side].getComponent(axis));
    const drag = (ray) => {
      const at = alongAxis(ray, place(), axis);
      if (at !== null) this.#set(axis, side, at);
      this.#change();
    };
    return { kind: 'face', place, drag };
  }

  #corner(sides) {
    const place = () => new THREE.Vector3(
      ...sides.map((side, axis) => this.box[side].getComponent(axis)));
    const drag = (ray) => {
      const towards = this.viewer.camera.getWorldDirection(new THREE.Vector3());
      onPlane(ray, place(), towards)?.toArray()
        .forEach((at, axis) => this.#set(axis, sides[axis], at));
      this.#change();
    };
    return { place, drag };
  }

  /** Move a side, not through the other one. */
  #set(axis, side, at) {
    const { low, high, longest } = this;
    const least = side === 'min' ? low[axis] - FARTHEST * longest
      : this.box.min.getComponent(axis) + THINNEST * longest;
    const most = side === 'max' ? high[axis] + FARTHEST * longest
      : this.box.max.getComponent(axis) - THINNEST * longest;
    this.box[side].setComponent(axis, this.frame.local(Math.min(Math.max(at, least), most), axis));
  }

  #change() {
    this.kept.box(this.box.min.toArray(), this.box.max.toArray());
    this.onChange();
  }
}
