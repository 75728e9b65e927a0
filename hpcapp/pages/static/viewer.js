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

const PLAIN = [0.8, 0.82, 0.86];
const UPS = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };

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
    this.renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.localClippingEnabled = true;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    element.append(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(40, 1, 0.01, 100);
    this.scene.add(new THREE.AmbientLight(0xffffff, 0.28 * Math.PI), this.camera);
    const lamp = new THREE.DirectionalLight(0xffffff, 0.72 * Math.PI);
    lamp.position.set(-0.4, 0.5, 1);
    this.camera.add(lamp, lamp.target);
    this.plane = new THREE.Plane(new THREE.Vector3(0, 0, -1), 0);
    this.clipping = null;
    this.up = 'z';
    this.box = new THREE.Box3();
    this.material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide });
    this.material.onBeforeCompile = (shader) => { // a back face is red: holes and cuts stand out
      shader.fragmentShader = shader.fragmentShader.replace('#include <color_fragment>',
        '#include <color_fragment>\nif (!gl_FrontFacing) diffuseColor.rgb = vec3(.75, .3, .25);');
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

  /** Set the points that are shown beside the meshes; colours are uint8 (n, 3), or null. */
  setPoints({ positions, step, low, colours }) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.BufferAttribute(positions, 3, true));
    const shown = colours ?? new Uint8Array(positions.length).map((_, i) => [30, 90, 200][i % 3]);
    geometry.setAttribute('color', new THREE.BufferAttribute(shown, 3, true));
    this.points = new THREE.Points(geometry, this.pointMaterial);
    this.#place(this.points, positions, step, low);
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

  /** Colour the vertices of a mesh: `shade(i, rgb)` writes three bytes; null is one plain colour. */
  colour(mesh, shade) {
    const colours = mesh.geometry.attributes.color.data;
    const rgb = PLAIN.map((part) => 255 * part);
    for (let i = 0; i < colours.count; i++) {
      if (shade) shade(i, rgb);
      colours.array[4 * i] = rgb[0];
      colours.array[4 * i + 1] = rgb[1];
      colours.array[4 * i + 2] = rgb[2];
    }
    colours.needsUpdate = true;
    this.render();
  }

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

  /** Look at everything, with the axis `up` upwards. */
  look(up = this.up) {
    this.up = up;
    this.controls?.dispose();
    const [middle, size] = [new THREE.Vector3(), new THREE.Vector3(1, 1, 1)];
    if (!this.box.isEmpty()) { this.box.getCenter(middle); this.box.getSize(size); }
    const radius = 0.5 * size.length() || 1;
    const aside = { x: [0.45, 0.55, 0.8], y: [0.55, 0.45, 0.8], z: [0.55, -0.8, 0.45] }[up];
    this.camera.up.set(...UPS[up]);
    this.camera.near = 0.01 * radius;
    this.camera.far = 100 * radius;
    const half = Math.tan(0.5 * Math.PI / 180 * this.camera.fov) * Math.min(1, this.camera.aspect);
    this.camera.position.set(...aside).normalize()
      .multiplyScalar(1.02 * radius / Math.sin(Math.atan(half))).add(middle);
    this.camera.updateProjectionMatrix();
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.target.copy(middle);
    this.controls.zoomToCursor = true;
    this.controls.addEventListener('change', () => this.render());
    this.controls.update();
    this.render();
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
    if (this.renderer.info.render.frame) this.draw(); // at once: a canvas of a new size is empty
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
    this.renderer.render(this.scene, this.camera);
    const { clientWidth: width, clientHeight: height } = this.element;
    for (const { label, place } of this.markers) {
      const seen = place.clone().project(this.camera);
      label.style.left = `${(0.5 + 0.5 * seen.x) * width}px`;
      label.style.top = `${(0.5 - 0.5 * seen.y) * height}px`;
      label.style.visibility = Math.abs(seen.z) > 1 ? 'hidden' : '';
    }
  }
}
