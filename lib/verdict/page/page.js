// Above the two photographs: drag the line, or move it by the arrow keys.
for (const pair of document.querySelectorAll('.pair')) {
  const input = pair.querySelector('input');
  const show = () => pair.style.setProperty('--at', input.value + '%');
  const move = event => {
    const box = pair.getBoundingClientRect();
    input.value = Math.max(0, Math.min(100, 100 * (event.clientX - box.left) / box.width));
    show();
  };
  input.step = 'any';
  input.addEventListener('input', show);
  input.addEventListener('keydown', event => {
    const step = {
      ArrowLeft: -2, ArrowDown: -2, ArrowRight: 2, ArrowUp: 2, PageDown: -20, PageUp: 20
    }[event.key];
    if (step === undefined) return;
    event.preventDefault();
    input.value = Number(input.value) + step;
    show();
  });
  pair.addEventListener('pointerdown', event => {
    if (event.button) return;
    pair.setPointerCapture(event.pointerId);
    input.focus({preventScroll: true});
    move(event);
  });
  pair.addEventListener('pointermove', event => {
    if (pair.hasPointerCapture(event.pointerId)) move(event);
  });
  show();
}
