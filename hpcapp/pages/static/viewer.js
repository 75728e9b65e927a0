// Draws triangle meshes and points, turns them, colours them, clips them, and marks places.
//
//   const viewer = new Viewer(element);
//   const mesh = viewer.addMesh({positions, step, low, indices});   // uint16 (v, 3), uint32 (f, 3)
//   viewer.colour(mesh, (i, rgb) => ...);  viewer.setPoints({...});  viewer.setMarkers([...]);
//
// A place is low + step * position. Nothing is drawn but what has changed.
import * as THREE from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';

THREE.ColorManagement.enabled = false; // colours are shown as they are stored

const PLAIN = [0.8, 0.82, 0.86], POINT = [30 / 255, 90 / 255, 200 / 255];
const BACK = [0.68, 0.6, 0.54]; // as in hpcapp/pages/render.py
const GLANCE = 128; // pixels along a side of the picture by which a room is told
const HIDDEN = 0.4; // of what is seen, as in hpcapp/pages/render.py
const SAMPLED = 20000; // places of a mesh by which the view is fitted
const MARGIN = 1.06; // around what is looked at
const FOV = 40, FLAT_FOV = 10; // degrees of the camera; from above, heights hardly move a place
const PICKED = 6; // pixels: so far from a point it is meant
const UPS = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1], '-x': [-1, 0, 0], '-y': [0, -1, 0],
  '-z': [0, 0, -1] };
const TURNED = 0.2; // of a mean normal away from the eye, as in hpcapp/pages/picture.py

/** The colour of back faces, as CSS. */
export const BACK_CSS = `rgb(${BACK.map((part) => Math.round(255 * part))})`;

/** Normals of the vertices: the sums of the faces' cross products, as int8. */
export function vertexNormals(positions, indices) {
  const sums = new Float32Array(positions.length);
  for (let f = 0; f < indices.length; f += 3) {
    const a = 3 * indices[f], b = 3 * indices[f + 1], c = 3 * indices[f + 2];
    const ux = positions[b] - positions[a], uy = positions[b + 1] - positions[a + 1];
    const uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a], vy = positions[c + 1] - positions[a + 1];
    const vz = positions[c + 2] - positions[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    sums[a] += x; sums[a + 1] += y; sums[a + 2] += z;
    sums[b] += x; sums[b + 1] += y; sums[b + 2] += z;
    sums[c] += x; sums[c + 1] += y; sums[c + 2] += z;
  }
  const normals = new Int8Array(4 * positions.length / 3); // four a vertex: aligned
  for (let i = 0, o = 0; i < sums.length; i += 3, o += 4) {
    const length = Math.hypot(sums[i], sums[i + 1], sums[i + 2]) || 1;
    normals[o] = Math.round(127 * sums[i] / length);
    normals[o + 1] = Math.round(127 * sums[i + 1] / length);
    normals[o + 2] = Math.round(127 * sums[i + 2] / length);
  }
  return normals;
}

/** The box of positions, as shares of 65535. */
function bounds(positions) {
  const low = [65535, 65535, 65535], high = [0, 0, 0];
  for (let i = 0; i < positions.length; i += 3) {
    for (let k = 0; k < 3; k++) {
      const at = positions[i + k];
      if (at < low[k]) low[k] = at;
      if (at > high[k]) high[k] = at;
    }
  }
  const box = new THREE.Box3();
  if (positions.length) box.min.fromArray(low).divideScalar(65535);
  if (positions.length) box.max.fromArray(high).divideScalar(65535);
  return box;
}

/** An attribute of some numbers out of every `stride`. */
function strided(array, stride, size) {
  return new THREE.InterleavedBufferAttribute(
    new THREE.InterleavedBuffer(array, stride), size, 0, true);
}

export class Viewer {
  constructor(element) {
    this.element = element;
    this.meshes = [];
    this.points = null;
    this.markers = [];
    this.overlays = []; // functions that place elements over each frame
    this.frames = 0;
    this.renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.localClippingEnabled = true;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    element.append(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(FOV, 1, 0.01, 100);
    this.scene.add(new THREE.AmbientLight(0xffffff, 0.28 * Math.PI), this.camera);
    const lamp = new THREE.DirectionalLight(0xffffff, 0.72 * Math.PI);
    lamp.position.set(-0.4, 0.5, 1);
    this.camera.add(lamp, lamp.target);
    this.plane = new THREE.Plane(new THREE.Vector3(0, 0, -1), 0);
    this.clipping = null;
    this.up = 'z';
    this.box = new THREE.Box3();
    this.material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide });
    this.material.onBeforeCompile = (shader) => { // a back face is tinted: holes and cuts show
      shader.fragmentShader = shader.fragmentShader.replace('#include <color_fragment>',
        `#include <color_fragment>\nif (!gl_FrontFacing) diffuseColor.rgb = vec3(${BACK});`);
    };
    this.pointMaterial = new THREE.PointsMaterial({ vertexColors: true, sizeAttenuation: false });
    this.setPointSize(2);
    this.setBackground('#ffffff');
    new ResizeObserver(() => this.resize()).observe(element);
    this.resize();
    this.look();
  }

  /** Add a mesh; returns it, for `colour`. */
  addMesh({ positions, step, low, indices }) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.BufferAttribute(positions, 3, true));
    geometry.setAttribute('normal', strided(vertexNormals(positions, indices), 4, 3));
    geometry.setAttribute('color',
      strided(new Uint8Array(4 * positions.length / 3).fill(255), 4, 3));
    geometry.setIndex(new THREE.BufferAttribute(indices, 1));
    const mesh = new THREE.Mesh(geometry, this.material);
    this.#place(mesh, positions, step, low);
    this.meshes.push(mesh);
    this.colour(mesh, null);
    return mesh;
  }

  /** Set the points that are shown, and return them, for `colour`. */
  setPoints({ positions, step, low }) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.BufferAttribute(positions, 3, true));
    geometry.setAttribute('color', strided(new Uint8Array(4 * positions.length / 3), 4, 3));
    this.points = new THREE.Points(geometry, this.pointMaterial);
    this.#place(this.points, positions, step, low);
    this.colour(this.points, null);
    return this.points;
  }

  #place(drawn, positions, step, low) {
    drawn.scale.setScalar(65535 * step); // attributes run from 0 to 1
    drawn.position.fromArray(low);
    drawn.frustumCulled = false;
    drawn.updateMatrixWorld();
    const box = bounds(positions); // three would find them again and again, number by number
    drawn.geometry.boundingBox = box;
    drawn.geometry.boundingSphere = box.getBoundingSphere(new THREE.Sphere());
    this.box.union(box.clone().applyMatrix4(drawn.matrixWorld));
    this.scene.add(drawn);
  }

  /** Colour vertices or points: `shade(i, rgb)` writes three bytes; null is one plain colour. */
  colour(drawn, shade) {
    const colours = drawn.geometry.attributes.color.data;
    const rgb = drawn.isPoints ? POINT.map((part) => 255 * part) : this.plain;
    for (let i = 0; i < colours.count; i++) {
      if (shade) shade(i, rgb);
      colours.array[4 * i] = rgb[0];
      colours.array[4 * i + 1] = rgb[1];
      colours.array[4 * i + 2] = rgb[2];
    }
    colours.needsUpdate = true;
    this.render();
  }

  /** The picture as it is seen, without labels: a PNG. */
  picture() {
    this.draw();
    return new Promise((resolve) => { this.renderer.domElement.toBlob(resolve, 'image/png'); });
  }

  /** The colour of what is drawn over the scene, as CSS. */
  get accent() { return getComputedStyle(document.body).getPropertyValue('--accent').trim(); }

  /** The one plain colour of a mesh: three numbers up to 255. */
  get plain() { return PLAIN.map((part) => 255 * part); }

  /** The normal of a vertex, as three numbers from -127 to 127. */
  normal(mesh, i) {
    return mesh.geometry.attributes.normal.data.array.subarray(4 * i, 4 * i + 3);
  }

  /** Mark places: [{place: [x, y, z], text}]; `onChosen(index)` is told of clicks. */
  setMarkers(markers, onChosen = () => {}) {
    this.markers.forEach((marker) => marker.label.remove());
    this.markers = markers.map(({ place, text }, index) => {
      const label = document.createElement('button');
      label.className = 'marker';
      label.textContent = index + 1;
      label.title = text;
      label.addEventListener('click', () => onChosen(index));
      this.element.append(label);
      return { label, place: new THREE.Vector3(...place) };
    });
    this.render();
  }

  /** Show or hide 'meshes', 'points' or 'markers'. */
  show(what, isShown) {
    if (what === 'meshes') this.meshes.forEach((mesh) => { mesh.visible = isShown; });
    if (what === 'points' && this.points) this.points.visible = isShown;
    if (what === 'markers') this.markers.forEach((m) => { m.label.hidden = !isShown; });
    this.render();
  }

  setWireframe(isWire) { this.material.wireframe = isWire; this.render(); }

  setFlat(isFlat) {
    this.material.flatShading = isFlat;
    this.material.needsUpdate = true;
    this.render();
  }

  /** Show or leave out faces that are seen from behind. */
  setBacks(isShown) {
    this.material.side = isShown ? THREE.DoubleSide : THREE.FrontSide;
    this.material.needsUpdate = true;
    this.render();
  }

  /** Whether back faces are drawn. */
  get hasBacks() { return this.material.side === THREE.DoubleSide; }

  setPointSize(pixels) {
    this.pointMaterial.size = pixels * this.renderer.getPixelRatio();
    this.render();
  }

  setBackground(colour) { this.scene.background = new THREE.Color(colour); this.render(); }

  /** Cut away what lies beyond a share (0 to 1) of the box along 'x', 'y' or 'z'; null: nothing. */
  clip(axis, share = 0.5, isFlipped = false) {
    this.clipping = axis;
    const planes = axis ? [this.plane] : null;
    if (axis) {
      const sign = isFlipped ? 1 : -1, along = new THREE.Vector3(...UPS[axis]);
      const at = this.box.min[axis] + share * (this.box.max[axis] - this.box.min[axis]);
      this.plane.normal.copy(along).multiplyScalar(sign);
      this.plane.constant = -sign * at;
    }
    for (const material of [this.material, this.pointMaterial]) {
      if ((material.clippingPlanes === null) !== (planes === null)) material.needsUpdate = true;
      material.clippingPlanes = planes;
    }
    this.render();
  }

  /** Look at all that is shown as `frame` does, and into a room through its near walls. */
  look(up = this.up, isAbove = false) {
    this.frame(up, isAbove);
    this.setBacks(!this.#looksAtRoom());
  }

  /**
   * Look at all that is shown, as large as fits, with the axis `up` upwards. From above it is seen
   * as a map: along z, with y upwards, moved and not turned.
   */
  frame(up = this.up, isAbove = false) {
    this.up = up;
    this.controls?.dispose();
    const middle = new THREE.Vector3(), size = new THREE.Vector3(1, 1, 1);
    if (!this.box.isEmpty()) { this.box.getCenter(middle); this.box.getSize(size); }
    const radius = 0.5 * size.length() || 1;
    this.camera.up.set(...UPS[isAbove ? 'z' : up]);
    this.camera.fov = isAbove ? FLAT_FOV : FOV;
    this.camera.near = (isAbove ? 0.05 : 0.01) * radius; // farther away: as fine in depth
    this.camera.far = 100 * radius;
    const back = isAbove ? new THREE.Vector3(0, -1e-4, 1).normalize() : this.#chooseSide();
    const { x, y, distance } = this.#fit(back, middle, radius);
    middle.add(x).add(y);
    this.camera.position.copy(back).multiplyScalar(distance).add(middle);
    this.camera.updateProjectionMatrix();
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.target.copy(middle);
    this.controls.zoomToCursor = true;
    if (isAbove) {
      this.controls.enableRotate = false;
      this.controls.mouseButtons.LEFT = THREE.MOUSE.PAN;
      this.controls.touches.ONE = THREE.TOUCH.PAN;
    }
    this.controls.addEventListener('change', () => this.render());
    this.controls.update();
    this.render();
  }

  /** Whether backs hide fronts in much of what is seen, as the near walls of a room do. */
  #looksAtRoom() {
    if (!this.meshes.length) return false;
    const target = new THREE.WebGLRenderTarget(GLANCE, GLANCE);
    const facing = new THREE.ShaderMaterial({
      vertexShader: 'void main() { gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.); }',
      fragmentShader: 'void main() { gl_FragColor = vec4(gl_FrontFacing, !gl_FrontFacing, 0., 1.); }',
    });
    const meshes = new THREE.Scene();
    meshes.overrideMaterial = facing;
    const count = (side) => { // pixels of fronts, and of backs
      facing.side = side;
      facing.needsUpdate = true;
      this.renderer.setRenderTarget(target);
      this.renderer.clear();
      meshes.children = this.meshes;
      this.renderer.render(meshes, this.camera);
      const rgba = new Uint8Array(4 * GLANCE * GLANCE), seen = [0, 0];
      this.renderer.readRenderTargetPixels(target, 0, 0, GLANCE, GLANCE, rgba);
      rgba.forEach((part, i) => { if (i % 4 < 2 && part > 127) seen[i % 4] += 1; });
      return seen;
    };
    const [fronts, backs] = count(THREE.DoubleSide), [all] = count(THREE.FrontSide);
    this.renderer.setRenderTarget(null);
    target.dispose();
    facing.dispose();
    return all - fronts > HIDDEN * (fronts + backs);
  }

  /** From where to look, by the axis that points up: from above, but at the front of a sheet. */
  #chooseSide() {
    const axis = this.up.at(-1), above = this.camera.up;
    const aside = { x: [0, 0.55, 0.8], y: [0.55, 0, 0.8], z: [0.55, -0.8, 0] }[axis];
    const back = new THREE.Vector3(...aside), mean = new THREE.Vector3(), one = new THREE.Vector3();
    let count = 0;
    for (const { geometry } of this.meshes) {
      const { normal } = geometry.attributes, step = Math.max(1, Math.floor(normal.count / SAMPLED));
      for (let i = 0; i < normal.count; i += step, count++) {
        mean.add(one.fromBufferAttribute(normal, i));
      }
    }
    if (mean.dot(back) < -TURNED * count) back.negate();
    const height = mean.dot(above) < -TURNED * count ? -0.45 : 0.45;
    return back.addScaledVector(above, height).normalize();
  }

  /** How far to move aside and away, that what is shown fills the view as seen from `back`. */
  #fit(back, middle, radius) {
    const right = this.camera.up.clone().cross(back).normalize(), above = back.clone().cross(right);
    const tall = Math.tan(0.5 * Math.PI / 180 * this.camera.fov), wide = tall * this.camera.aspect;
    // A place is in view where distance * tangent is no less than these, one for each side.
    const sides = { left: -Infinity, right: -Infinity, below: -Infinity, above: -Infinity };
    const shown = [...this.meshes, this.points].filter((one) => one?.visible);
    const place = new THREE.Vector3();
    for (const one of shown) {
      const { position } = one.geometry.attributes;
      const step = Math.max(1, Math.floor(position.count / SAMPLED));
      for (let i = 0; i < position.count; i += step) {
        place.fromBufferAttribute(position, i).applyMatrix4(one.matrixWorld).sub(middle);
        const x = place.dot(right), y = place.dot(above), z = place.dot(back);
        sides.left = Math.max(sides.left, z * wide - x);
        sides.right = Math.max(sides.right, z * wide + x);
        sides.below = Math.max(sides.below, z * tall - y);
        sides.above = Math.max(sides.above, z * tall + y);
      }
    }
    if (sides.left === -Infinity) { // nothing is there yet
      sides.left = sides.right = radius * Math.hypot(1, wide);
      sides.below = sides.above = radius * Math.hypot(1, tall);
    }
    return {
      x: right.multiplyScalar(0.5 * (sides.right - sides.left)),
      y: above.multiplyScalar(0.5 * (sides.above - sides.below)),
      distance: MARGIN * Math.max(0.5 * (sides.left + sides.right) / wide,
        0.5 * (sides.below + sides.above) / tall, 0.1 * radius),
    };
  }

  /** What casts a ray into the scene from a place of the window. */
  #caster(clientX, clientY) {
    const { left, top, width, height } = this.renderer.domElement.getBoundingClientRect();
    const caster = new THREE.Raycaster();
    caster.setFromCamera(new THREE.Vector2(2 * (clientX - left) / width - 1,
      1 - 2 * (clientY - top) / height), this.camera);
    return caster;
  }

  /** The ray from the camera through a place of the window. */
  ray(clientX, clientY) { return this.#caster(clientX, clientY).ray; }

  /** The place on a mesh or of a point that is seen at a place of the window, or null. */
  pick(clientX, clientY) {
    const caster = this.#caster(clientX, clientY), { clientHeight } = this.element;
    const far = this.camera.position.distanceTo(this.controls.target);
    caster.params.Points.threshold = PICKED * far * Math.tan(Math.PI / 360 * this.camera.fov)
      / (0.5 * clientHeight);
    const shown = [...this.meshes, this.points].filter((one) => one?.visible);
    const isLeft = ({ point }) => !this.clipping || this.plane.distanceToPoint(point) >= 0;
    const hits = caster.intersectObjects(shown, false).filter(isLeft);
    return hits.length ? hits[0].point.toArray() : null;
  }

  /** Draw a line between places [[x, y, z], ...] with a label at its end, and dots at both. */
  setLine(places, text = '') {
    this.line?.parts.forEach((part) => part.remove());
    this.line = null;
    if (places.length) {
      const make = (className, words = '') => {
        const part = document.createElement('div');
        part.className = className;
        part.textContent = words;
        this.element.append(part);
        return part;
      };
      const dots = places.map(() => make('dot'));
      const stroke = make('stroke'), label = make('length', text);
      label.hidden = !text;
      this.line = { places: places.map((one) => new THREE.Vector3(...one)), dots, stroke, label,
        parts: [...dots, stroke, label] };
    }
    this.render();
  }

  /** Go back until places are seen, but not for ever. */
  include(places) {
    const { target } = this.controls;
    const isSeen = (place) => { // of the middle nine tenths
      const { x, y } = place.clone().project(this.camera);
      return Math.max(Math.abs(x), Math.abs(y)) < 0.9;
    };
    for (let step = 0; step < 20 && !places.every(isSeen); step++) {
      this.camera.position.sub(target).multiplyScalar(1.1).add(target);
      this.camera.updateMatrixWorld();
    }
    this.controls.update();
  }

  /** Look closely at a place, from where the camera is. */
  approach(place) {
    const target = new THREE.Vector3(...place);
    const radius = 0.5 * this.box.getSize(new THREE.Vector3()).length();
    const middle = this.box.getCenter(new THREE.Vector3());
    const back = target.clone().sub(middle); // from outside, where it is not the middle itself
    if (back.length() < 0.05 * radius) back.copy(this.camera.position).sub(target);
    this.camera.position.copy(target).add(back.setLength(1.2 * radius));
    this.controls.target.copy(target);
    this.controls.update();
    this.render();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (this.frames) this.draw(); // at once: a canvas of a new size is empty
  }

  /** Draw nothing until `resume`: a frame of a large mesh takes its time. */
  pause() { this.isPaused = true; }

  resume() { this.isPaused = false; this.render(); }

  /** Draw before the next frame, once. */
  render() {
    if (this.isAsked || this.isPaused) return;
    this.isAsked = true;
    requestAnimationFrame(() => {
      this.isAsked = false;
      if (!this.isPaused) this.draw();
    });
  }

  draw() {
    this.frames += 1;
    this.renderer.render(this.scene, this.camera);
    for (const { label, place } of this.markers) this.put(label, place);
    if (this.line) this.#drawLine();
    for (const place of this.overlays) place();
  }

  #drawLine() {
    const { places, dots, stroke, label } = this.line;
    const [from, to] = places.map((place, k) => this.put(dots[k], place));
    stroke.hidden = !to;
    if (!to) return;
    stroke.style.left = `${from[0]}px`;
    stroke.style.top = `${from[1]}px`;
    stroke.style.width = `${Math.hypot(to[0] - from[0], to[1] - from[1])}px`;
    stroke.style.rotate = `${Math.atan2(to[1] - from[1], to[0] - from[0])}rad`;
    this.put(label, places[0].clone().lerp(places[1], 0.5));
  }

  /** Put an element where a place is seen; returns that, in pixels. */
  put(element, place) {
    const { clientWidth: width, clientHeight: height } = this.element;
    const seen = place.clone().project(this.camera);
    const [left, top] = [(0.5 + 0.5 * seen.x) * width, (0.5 - 0.5 * seen.y) * height];
    element.style.left = `${left}px`;
    element.style.top = `${top}px`;
    element.style.visibility = Math.abs(seen.z) > 1 ? 'hidden' : '';
    return [left, top];
  }
}
