// Presses of a mouse or a finger that stay where they are: those that move turn the view.
const STILL = { mouse: 4, pen: 6, touch: 10 }; // pixels

/** Call `act(clientX, clientY)` for each tap on an element with one pointer alone. */
export function onTap(element, act) {
  const pressed = new Map();
  let isAlone = true;
  element.addEventListener('pointerdown', (event) => {
    isAlone = pressed.size === 0;
    pressed.set(event.pointerId, event);
  });
  const release = (event) => {
    const { clientX, clientY } = pressed.get(event.pointerId) ?? {};
    pressed.delete(event.pointerId);
    const moved = Math.hypot(event.clientX - clientX, event.clientY - clientY);
    if (event.type === 'pointerup' && isAlone && event.button === 0
      && moved < (STILL[event.pointerType] ?? STILL.mouse)) act(event.clientX, event.clientY);
  };
  element.addEventListener('pointerup', release);
  element.addEventListener('pointercancel', release);
}
