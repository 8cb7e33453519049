// The driver's view: speed and its limits, distance to the stop, and what protection does and why.

const FRESH_NS = 5e8; // age beyond which a value is not shown, as in the display of `vobc run`
const FAR_STOP_M = 79e3; // VOBC_TARGET: from here on there is no stopping point ahead
const TARGETS = { LINE_LIMIT: "line limit", RESTRICTION: "restriction", END: "end of authority" };
const SHUTDOWN_NS = 1e9; // the controller ends with its safe output, within the last second of a log
const DIAL_FROM = 0.75 * Math.PI, DIAL_SWEEP = 1.5 * Math.PI;
const BAR_M = [1, 1000]; // ends of the bar of the distance, which is logarithmic
const DRIVE = {
  speed: ["VOBC_MOTION.speed_mps"], permitted: ["VOBC_MOTION.ceiling_mps"], emergency: ["VOBC_MOTION.emergency_mps"],
  warning: ["VOBC_LIMITS.warning_mps", "cycles.warning_mps"], service: ["VOBC_LIMITS.service_mps", "cycles.service_mps"],
  intervention: ["VOBC_SUPERVISION.intervention"], reason: ["VOBC_SUPERVISION.reason"],
  target: ["VOBC_SUPERVISION.target_kind"], targetSpeed: ["VOBC_SUPERVISION.target_mps"], targetIn: ["VOBC_SUPERVISION.target_distance_m"],
  stop: ["VOBC_TARGET.distance_to_stop_m"], authority: ["VOBC_TARGET.distance_to_authority_m"],
  supervision: ["VOBC_STATUS.supervision"], phase: ["VOBC_STATUS.ato_phase"], missing: ["VOBC_STATUS.missing"],
  mode: ["VOBC_MODE.mode"], cause: ["VOBC_MODE.cause"], inhibits: ["VOBC_MODE.departure_inhibits"], withheld: ["VOBC_MODE.doors_withheld"],
  front: ["VOBC_POSITION.front_m"], uncertainty: ["VOBC_POSITION.uncertainty_m"],
  left: ["DOOR_STATUS.left"], right: ["DOOR_STATUS.right"], traction: ["TRACTION_STATUS.force_n"],
  brake: ["BRAKE_STATUS.applied_decel_mps2"], emergencyBrake: ["BRAKE_STATUS.emergency_applied"], holding: ["BRAKE_STATUS.holding_applied"],
};
const STATUS = { NO_AUTHORITY: ["quiet", "held: "], NOMINAL: ["ink", ""], WARNING: ["warn", "! "], SERVICE: ["warn", "service brake: "], EMERGENCY: ["bad", "■ "] };

class Drive {
  constructor(section) {
    this.section = section; this.canvas = section.querySelector("canvas"); this.list = section.querySelector("dl"); this.drawn = 0;
  }

  get there() { return view.byFull.has(DRIVE.speed[0]); }
  // Without a cursor the newest instant; a finished log shows the one before the controller shut down.
  get t() { return view.hover ?? view.cursor ?? Math.max(view.first, Math.min(view.to, view.last - (live.on ? 0 : SHUTDOWN_NS))); }

  async draw() {
    this.section.hidden = !this.there;
    if (!this.there) return;
    const stamp = ++this.drawn, now = await this.now(this.t);
    if (stamp !== this.drawn) return;
    view.drive = now;
    this.dial(now);
    this.words(now);
  }

  // Values at an instant, and the texts of the named ones; NaN for what is unknown or too old.
  async now(t) {
    const chosen = Object.entries(DRIVE).map(([role, names]) => [role, names.map(name => view.byFull.get(name)).find(Boolean)]).filter(([, signal]) => signal);
    const signals = chosen.map(([, signal]) => signal);
    const values = view.source.trace ? signals.map(signal => freshValue(signal, t)) : await view.source.values(signals, t);
    const now = { text: {} };
    chosen.forEach(([role, signal], k) => {
      now[role] = values[k];
      now.text[role] = Number.isNaN(values[k]) ? "" : valueText(signal, values[k], signal.extra ? undefined : Math.round((values[k] - signal.offset) / signal.scale));
    });
    return now;
  }

  top(now) {
    const limits = (journey?.told.limits ?? []).map(each => each[2]);
    const most = Math.max(60 / KMH, ...limits, ...[now.speed, now.emergency].filter(Number.isFinite)) * KMH * 1.12;
    this.most = Math.max(this.most ?? 0, Math.ceil(most / 20) * 20);
    return this.most;
  }

  dial(now) {
    const { context, width, height } = sharp(this.canvas), bar = 44;
    const radius = Math.min((width - bar) / 2, height * 0.56) - 15, x = bar + (width - bar) / 2, y = radius + 15, top = this.top(now);
    if (radius < 20) return;
    const angle = kmh => DIAL_FROM + DIAL_SWEEP * Math.min(1, Math.max(0, kmh / top));
    const arc = (from, to, size, color) => { context.strokeStyle = color; context.lineWidth = size; context.beginPath(); context.arc(x, y, radius - 4 - size / 2 + 4, angle(from), angle(to)); context.stroke(); };
    const known = value => Number.isFinite(value), kmh = value => value * KMH;
    arc(0, top, 6, colors.rule);
    const [tone] = STATUS[now.text.supervision] ?? ["quiet"];
    if (known(now.permitted)) arc(0, kmh(now.permitted), 6, colors.quiet);
    if (known(now.permitted) && known(now.emergency)) arc(kmh(now.permitted), kmh(now.emergency), now.speed > now.permitted ? 11 : 4, now.speed > now.permitted ? colors[tone] : colors.warn);
    context.textAlign = "center"; context.textBaseline = "middle"; context.fillStyle = colors.quiet;
    for (let each = 0; each <= top; each += 10) {
      const a = angle(each), long = each % 20 === 0, inner = radius - (long ? 18 : 13);
      context.strokeStyle = colors.quiet; context.lineWidth = long ? 1.6 : 1; context.beginPath();
      context.moveTo(x + Math.cos(a) * (radius - 9), y + Math.sin(a) * (radius - 9)); context.lineTo(x + Math.cos(a) * inner, y + Math.sin(a) * inner); context.stroke();
      if (long && radius > 55) context.fillText(String(each), x + Math.cos(a) * (radius - 29), y + Math.sin(a) * (radius - 29));
    }
    // Each limit has a letter, so that no meaning rests on colour alone.
    let before = -Infinity;
    for (const [letter, value, color] of [["P", now.permitted, colors.ink], ["W", now.warning, colors.warn], ["S", now.service, colors.warn], ["E", now.emergency, colors.bad]]) {
      if (!known(value) || value < 0) continue;
      const a = angle(kmh(value)), out = radius + 2;
      context.strokeStyle = color; context.lineWidth = 2; context.beginPath();
      context.moveTo(x + Math.cos(a) * (radius - 12), y + Math.sin(a) * (radius - 12)); context.lineTo(x + Math.cos(a) * out, y + Math.sin(a) * out); context.stroke();
      if (a - before < 9 / radius) continue;
      before = a;
      context.fillStyle = color; context.fillText(letter, x + Math.cos(a) * (radius + 9), y + Math.sin(a) * (radius + 9));
    }
    if (known(now.speed)) {
      const a = angle(kmh(now.speed));
      context.strokeStyle = colors[tone]; context.lineWidth = 4; context.lineCap = "round"; context.beginPath();
      context.moveTo(x + Math.cos(a) * radius * 0.3, y + Math.sin(a) * radius * 0.3); context.lineTo(x + Math.cos(a) * (radius - 14), y + Math.sin(a) * (radius - 14)); context.stroke(); context.lineCap = "butt";
    }
    context.fillStyle = colors[tone]; context.font = `600 ${Math.round(radius * 0.3)}px system-ui, sans-serif`;
    context.fillText(known(now.speed) ? String(Math.round(Math.abs(kmh(now.speed)))) : "–", x, y);
    context.font = FONT; context.fillStyle = colors.quiet; context.fillText("km/h", x, y + radius * 0.26);
    this.bar(context, now, height);
  }

  bar(context, now, height) {
    const top = 18, bottom = height - 6, at = metres => bottom - (bottom - top) * Math.min(1, Math.max(0, Math.log(metres / BAR_M[0]) / Math.log(BAR_M[1] / BAR_M[0])));
    context.font = FONT; context.textBaseline = "middle"; context.textAlign = "right"; context.fillStyle = context.strokeStyle = colors.quiet; context.lineWidth = 1;
    for (const metres of [1, 10, 100, 1000]) { const y = Math.round(at(metres)) + 0.5; context.beginPath(); context.moveTo(34, y); context.lineTo(48, y); context.stroke(); context.fillText(String(metres), 32, y); }
    const stop = now.stop <= FAR_STOP_M ? now.stop : now.target ? now.targetIn : NaN;
    if (!Number.isFinite(stop) || stop > FAR_STOP_M) return;
    context.fillStyle = colors.accent; context.fillRect(38, at(Math.max(BAR_M[0], stop)), 8, bottom - at(Math.max(BAR_M[0], stop)));
  }

  words(now) {
    const { text } = now, low = word => word.replaceAll("_", " ").toLowerCase(), [tone, sign] = STATUS[text.supervision] ?? ["quiet", ""];
    const silent = Number.isNaN(now.speed) && Number.isNaN(now.supervision);
    const far = value => !Number.isFinite(value) || value > FAR_STOP_M;
    const rows = [
      ["protection", silent ? "the controller is silent" : sign + low(text.supervision ?? ""), silent ? "bad" : tone],
      ["why", this.why(now, low), ""],
      ["mode", low(text.mode ?? ""), ""],
      ["ATO", low(text.phase ?? ""), ""],
      ["stop in", far(now.stop) ? "–" : `${now.stop.toFixed(2)} m`, ""],
      ["target", now.target ? `${TARGETS[text.target] ?? low(text.target)} in ${now.targetIn.toFixed(0)} m, ${(now.targetSpeed * KMH).toFixed(0)} km/h` : "–", ""],
      ["limits, km/h", ["permitted", "warning", "service", "emergency"].filter(role => Number.isFinite(now[role])).map(role => `${role === "permitted" ? "P" : role[0].toUpperCase()} ${(now[role] * KMH).toFixed(1)}`).join("  "), ""],
      ["brake", Number.isFinite(now.brake) ? `${now.brake.toFixed(2)} m/s²${text.emergencyBrake === "TRUE" ? ", emergency" : text.holding === "TRUE" ? ", holding" : ""}` : "–", text.emergencyBrake === "TRUE" ? "bad" : ""],
      ["traction", Number.isFinite(now.traction) ? `${(now.traction / 1000).toFixed(0)} kN` : "–", ""],
      ["doors", [["left", text.left], ["right", text.right]].filter(([, state]) => state).map(([side, state]) => `${side} ${low(state)}`).join(", ") || "–", ""],
    ];
    while (this.list.children.length < 2 * rows.length) this.list.append(document.createElement(this.list.children.length % 2 ? "dd" : "dt"));
    rows.forEach(([name, value, kind], k) => {
      const [title, cell] = [this.list.children[2 * k], this.list.children[2 * k + 1]];
      if (title.textContent !== name) title.textContent = name;
      if (cell.textContent !== value) cell.textContent = cell.title = value;
      if (cell.className !== kind) cell.className = kind;
    });
  }

  // Why the train brakes or does not leave, in the order of urgency.
  why(now, low) {
    const { text } = now, list = flags => low(flags).split("|").join(", ");
    if (text.supervision === "EMERGENCY") return now.cause ? `emergency brake: ${low(text.cause)}` : "safe output: the controller starts or ends";
    if (now.intervention) return low(text.intervention) + (now.reason ? `: ${low(text.reason)}` : now.missing ? `: waits for ${list(text.missing)}` : "");
    if (now.missing) return `waits for ${list(text.missing)}`;
    if (text.supervision === "SERVICE") return "speed above the service limit";
    if (text.supervision === "WARNING") return "speed above the warning limit";
    if (now.speed === 0 && now.inhibits) return `may not depart: ${list(text.inhibits)}`;
    if (text.phase === "STOPPED" && now.withheld) return `doors shut: ${list(text.withheld)}`;
    return "–";
  }
}

function freshValue(signal, t) {
  const trace = view.source.trace(signal), at = trace.indexAt(t);
  const fresh = Math.max(FRESH_NS, 2.5e6 * (signal.message?.period ?? 0));
  return at < 0 || t - trace.t[at] > fresh ? NaN : trace.v[at];
}
