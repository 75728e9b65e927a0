// What is kept is drawn as before; the rest is pale and seen through, exactly up to the border.
import * as THREE from 'three';

export const MOST_CORNERS = 100; // of a polygon: uniforms are few
const PALE = 0.5; // towards the background
const OFF = 0, BOX = 1, POLYGON = 2, PIECES = 3;

const VERTEX = `
attribute float piece;
varying vec3 cutPlace;
varying float cutPiece;
void main() {
  cutPlace = (modelMatrix * vec4(position, 1.)).xyz;
  cutPiece = piece;`;

const FRAGMENT = `
uniform int cutKind, cutCount;
uniform vec3 cutLow, cutHigh, cutGround;
uniform vec2 cutCorners[${MOST_CORNERS}];
uniform float cutMost;
varying vec3 cutPlace;
varying float cutPiece;
bool isKept() {
  if (cutKind == ${BOX}) {
    return all(greaterThanEqual(cutPlace, cutLow)) && all(lessThanEqual(cutPlace, cutHigh));
  }
  if (cutKind == ${PIECES}) return cutPiece < cutMost - .5;
  if (cutKind != ${POLYGON}) return true;
  bool isInside = false;
  vec2 from = cutCorners[cutCount - 1];
  for (int k = 0; k < cutCount; k++) { // a ray along x crosses the sides an odd number of times
    vec2 to = cutCorners[k];
    if ((from.y > cutPlace.y) != (to.y > cutPlace.y) && cutPlace.x < from.x
      + (cutPlace.y - from.y) / (to.y - from.y) * (to.x - from.x)) isInside = !isInside;
    from = to;
  }
  return isInside;
}
void main() {
  bool isCut = !isKept();
  if (isCut && mod(floor(gl_FragCoord.x) + floor(gl_FragCoord.y), 2.) < .5) discard;`;

const PAINT = `#include <opaque_fragment>
  if (isCut) gl_FragColor.rgb = mix(gl_FragColor.rgb, cutGround, ${PALE});`;

export class Kept {
  constructor(viewer) {
    this.viewer = viewer;
    this.uniforms = {
      cutKind: { value: OFF }, cutCount: { value: 0 }, cutMost: { value: 0 },
      cutLow: { value: new THREE.Vector3() }, cutHigh: { value: new THREE.Vector3() },
      cutGround: { get value() { return viewer.scene.background; } }, // it follows the theme
      cutCorners: { value: Array.from({ length: MOST_CORNERS }, () => new THREE.Vector2()) },
    };
    for (const material of [viewer.material, viewer.pointMaterial]) {
      const before = material.onBeforeCompile;
      material.onBeforeCompile = (shader, renderer) => {
        before.call(material, shader, renderer);
        Object.assign(shader.uniforms, this.uniforms);
        shader.vertexShader = shader.vertexShader.replace('void main() {', VERTEX);
        shader.fragmentShader = shader.fragmentShader.replace('void main() {', FRAGMENT)
          .replace('#include <opaque_fragment>', PAINT);
      };
      material.needsUpdate = true;
    }
  }

  /** Keep everything. */
  all() { this.#keep(OFF); }

  /** Keep what lies between two corners in the frame of the scene. */
  box(low, high) {
    this.uniforms.cutLow.value.fromArray(low);
    this.uniforms.cutHigh.value.fromArray(high);
    this.#keep(BOX);
  }

  /** Keep what lies above and below a polygon, of three corners [x, y] or more. */
  polygon(corners) {
    corners.forEach((corner, k) => this.uniforms.cutCorners.value[k].fromArray(corner));
    this.uniforms.cutCount.value = corners.length;
    this.#keep(POLYGON);
  }

  /** Keep the largest pieces. */
  pieces(most) {
    this.uniforms.cutMost.value = most;
    this.#keep(PIECES);
  }

  #keep(kind) {
    this.uniforms.cutKind.value = kind;
    this.viewer.render();
  }
}
