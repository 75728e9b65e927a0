// Dots over the view that are dragged with a mouse or a finger; all else turns the view.
import * as THREE from 'three';

const REACH = { mouse: 12, pen: 16, touch: 26 }; // pixels around a dot

export class Handles {
  constructor(viewer) {
    Object.assign(this, { viewer, handles: [], dragged: null });
    const { element } = viewer;
    viewer.overlays.push(() => this.#place());
    // The canvas, where the view is turned, hears of a press after this element.
    element.addEventListener('pointerdown', (event) => this.#press(event), true);
    element.addEventListener('pointermove', (event) => this.#move(event));
    for (const end of ['pointerup', 'pointercancel']) {
      element.addEventListener(end, (event) => this.#release(event));
    }
  }

  /** Show handles: `place()` is where one is, `drag(ray)` moves it; they replace those before. */
  set(handles) {
    this.handles.forEach(({ dot }) => dot.remove());
    this.handles = handles.map((handle) => {
      const dot = document.createElement('div');
      dot.className = `dot handle ${handle.kind ?? ''}`;
      this.viewer.element.append(dot);
      return { ...handle, dot };
    });
    this.viewer.render();
  }

  #place() {
    for (const handle of this.handles) handle.at = this.viewer.put(handle.dot, handle.place());
  }

  #press(event) {
    if (this.dragged) { event.stopPropagation(); return; } // a second finger
    if (event.button !== 0 || event.target !== this.viewer.renderer.domElement) return;
    const { left, top } = this.viewer.element.getBoundingClientRect();
    const x = event.clientX - left, y = event.clientY - top;
    const distance = ({ at }) => Math.hypot(at[0] - x, at[1] - y);
    const near = this.handles.filter(({ dot, at }) => at && dot.style.visibility !== 'hidden')
      .sort((a, b) => distance(a) - distance(b))[0];
    if (!near || distance(near) > (REACH[event.pointerType] ?? REACH.mouse)) return;
    event.stopPropagation();
    event.preventDefault();
    this.viewer.element.setPointerCapture(event.pointerId);
    near.dot.classList.add('dragged');
    const aside = [near.at[0] - x, near.at[1] - y];
    this.dragged = { handle: near, pointer: event.pointerId, aside };
  }

  #move(event) {
    if (this.dragged?.pointer !== event.pointerId) return;
    const [x, y] = this.dragged.aside;
    this.dragged.handle.drag(this.viewer.ray(event.clientX + x, event.clientY + y));
    this.viewer.render();
  }

  #release(event) {
    if (this.dragged?.pointer !== event.pointerId) return;
    this.dragged.handle.dot.classList.remove('dragged');
    this.dragged = null;
  }
}

/** Where along an axis (0 to 2) a line through a place is nearest to a ray; null where parallel. */
export function alongAxis(ray, place, axis) {
  const away = place.clone().sub(ray.origin), along = ray.direction.getComponent(axis);
  const parallel = 1 - along * along;
  if (parallel < 1e-3) return null; // one looks along the axis
  return place.getComponent(axis)
    + (along * ray.direction.dot(away) - away.getComponent(axis)) / parallel;
}

/** Where a ray meets the plane through a place that a normal stands on, or null. */
export function onPlane(ray, place, normal) {
  const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(normal, place);
  return ray.intersectPlane(plane, new THREE.Vector3());
}
