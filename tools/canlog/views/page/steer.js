// Pointer on plots: the wheel zooms, Shift+wheel and drag pan, Shift+drag selects a span, a click
// pins the cursor.

const CLICK_PX = 4;

function steer(canvas) {
  let drag = null;
  const place = event => { const box = canvas.getBoundingClientRect(); return { x: event.clientX - box.left, width: box.width }; };
  canvas.addEventListener("wheel", event => {
    if (event.altKey) return; // scrolls the panels
    event.preventDefault();
    const { x, width } = place(event), turned = event.deltaY || event.deltaX, unit = event.deltaMode === 1 ? 30 : 1;
    if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) pan((event.deltaX || turned) * unit / width);
    else zoom(1.0018 ** (turned * unit), tOf(x, width));
  }, { passive: false });
  canvas.addEventListener("pointerdown", event => {
    if (event.button) return;
    const { x, width } = place(event);
    canvas.setPointerCapture(event.pointerId);
    drag = { x, width, from: view.from, to: view.to, choose: event.shiftKey, moved: false };
  });
  canvas.addEventListener("pointermove", event => {
    const { x, width } = place(event);
    if (!drag) { setCursor(tOf(x, width)); return; }
    drag.moved ||= Math.abs(x - drag.x) > CLICK_PX;
    if (!drag.moved) return;
    if (drag.choose) { choosing(canvas, drag.x, x); return; }
    const by = (drag.x - x) / (width - LEFT - RIGHT) * (drag.to - drag.from);
    setSpan(drag.from + by, drag.to + by, false);
  });
  canvas.addEventListener("pointerup", event => {
    if (!drag) return;
    const { x, width } = place(event);
    choosing(canvas, 0, 0);
    if (!drag.moved) setCursor(tOf(x, width), true);
    else if (drag.choose) setSpan(...[tOf(drag.x, width), tOf(x, width)].sort((a, b) => a - b));
    else view.spans.push([drag.from, drag.to]);
    drag = null;
  });
  canvas.addEventListener("pointercancel", () => { drag = null; choosing(canvas, 0, 0); });
  canvas.addEventListener("pointerleave", () => { if (!drag) setCursor(null); });
  canvas.addEventListener("dblclick", wholeSpan);
}

// Shows the span that is being selected over the canvas.
function choosing(canvas, from, to) {
  let band = document.getElementById("choosing");
  if (from === to) { band?.remove(); return; }
  if (!band) {
    band = document.createElement("div");
    band.id = "choosing";
    document.body.append(band);
  }
  const box = canvas.getBoundingClientRect(), views = document.getElementById("panels").getBoundingClientRect();
  Object.assign(band.style, {
    position: "fixed", left: `${box.left + Math.min(from, to)}px`, width: `${Math.abs(to - from)}px`, top: `${views.top}px`,
    height: `${views.height}px`, background: colors.accent, opacity: 0.18, pointerEvents: "none",
  });
}

function steerOverview(canvas) {
  let grip = null;
  const timeAt = event => { const box = canvas.getBoundingClientRect(); return overview.t(event.clientX - box.left, box.width); };
  const edge = event => { // which end of the window is near, or whether the pointer is inside
    const box = canvas.getBoundingClientRect(), x = event.clientX - box.left;
    if (Math.abs(x - overview.x(view.from, box.width)) < 6) return "from";
    if (Math.abs(x - overview.x(view.to, box.width)) < 6) return "to";
    const whole = view.to - view.from > 0.97 * (view.last - view.first);
    return !whole && x > overview.x(view.from, box.width) && x < overview.x(view.to, box.width) ? "move" : "new";
  };
  canvas.addEventListener("pointerdown", event => {
    canvas.setPointerCapture(event.pointerId);
    grip = { how: edge(event), t: timeAt(event), from: view.from, to: view.to };
    view.spans.push([view.from, view.to]);
  });
  canvas.addEventListener("pointermove", event => {
    canvas.style.cursor = { move: "grab", new: "crosshair" }[edge(event)] || "ew-resize";
    if (!grip) return;
    const t = timeAt(event);
    if (grip.how === "move") setSpan(grip.from + t - grip.t, grip.to + t - grip.t, false);
    else if (grip.how === "new") { if (t !== grip.t) setSpan(Math.min(t, grip.t), Math.max(t, grip.t), false); }
    else setSpan(...(grip.how === "from" ? [Math.min(t, grip.to), grip.to] : [grip.from, Math.max(t, grip.from)]), false);
  });
  canvas.addEventListener("pointerup", () => { grip = null; });
  canvas.addEventListener("dblclick", wholeSpan);
  canvas.addEventListener("wheel", event => { event.preventDefault(); zoom(1.0018 ** event.deltaY, timeAt(event)); }, { passive: false });
}
