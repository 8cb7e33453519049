// The faults of a run that takes them by hand: the catalogue, and those that began.

const faults = { byName: new Map(), told: new Set() };

function startFaults() {
  document.querySelector('[data-tab="faults"]').hidden = false;
  const kinds = $("fault-kinds");
  for (const place of view.head.faults) {
    const heading = document.createElement("h3");
    heading.textContent = place.title;
    kinds.append(heading, ...place.kinds.map(kindEntry));
  }
  $("fault-search").oninput = searchFaults;
  showBegun([]);
  showTab("faults");
}

// One entry of the catalogue: what the fault does, and its parameters.
function kindEntry(kind) {
  faults.byName.set(kind.name, kind);
  const entry = document.createElement("details"), summary = document.createElement("summary"), name = document.createElement("b");
  name.textContent = kind.name;
  summary.append(name, ` ${kind.story}`);
  entry.append(summary);
  entry.dataset.text = `${kind.name} ${kind.story}`.toLowerCase();
  if (kind.missing) {
    const why = document.createElement("p");
    why.className = "hint"; why.textContent = kind.missing;
    entry.append(why);
    return entry;
  }
  const form = faultForm(kind, {}, "Start");
  form.onsubmit = event => { event.preventDefault(); tellFault({ act: "start", fault: kind.name, values: valuesOf(form) }); };
  entry.append(form);
  return entry;
}

function faultForm(kind, given, act) {
  const form = document.createElement("form"), button = document.createElement("button");
  form.append(...kind.parameters.map(parameter => field(parameter, given[parameter.name] ?? parameter.value)));
  button.textContent = act;
  form.append(button);
  return form;
}

function field(parameter, value) {
  const label = document.createElement("label"), text = document.createElement("span"), input = inputOf(parameter, value), note = document.createElement("small");
  text.textContent = parameter.name;
  input.name = parameter.name; input.dataset.kind = parameter.kind;
  note.textContent = [parameter.unit, parameter.range, parameter.story, parameter.kind === "table of numbers" ? "name=value, name=value" : ""].filter(Boolean).join(" · ");
  label.append(text, input, note);
  return label;
}

function inputOf(parameter, value) {
  const { kind } = parameter, chosen = kind.split(", ");
  if (chosen.length > 1) {
    const select = document.createElement("select");
    select.append(...chosen.map(name => new Option(name, name, false, name === value)));
    return select;
  }
  const input = document.createElement("input");
  if (kind === "true or false") { input.type = "checkbox"; input.checked = value; return input; }
  input.type = kind.endsWith("number") ? "number" : "text";
  input.spellcheck = false;
  if (input.type === "number") {
    [input.min, input.max] = parameter.range.replaceAll("−", "-").split(" … ");
    input.step = kind === "number" ? "any" : "1";
  }
  input.value = typeof value === "object" && value ? Object.entries(value).map(pair => pair.join("=")).join(", ") : value ?? "";
  return input;
}

// A field that is left empty leaves the parameter at its default.
function valuesOf(form) {
  const values = {};
  for (const input of form.querySelectorAll("[name]")) {
    const { kind } = input.dataset;
    if (input.type === "checkbox") values[input.name] = input.checked;
    else if (!input.value.trim()) continue;
    else if (input.type === "number") values[input.name] = Number(input.value);
    else if (kind === "table of numbers") values[input.name] = Object.fromEntries(input.value.split(",").map(pair => pair.split("=")).map(([name, text]) => [name.trim(), Number(text)]));
    else values[input.name] = input.value;
  }
  return values;
}

function tellFault(told) { $("fault-refused").textContent = ""; tellDesk({ kind: "fault", ...told }); }

// Shows the faults that the bench recorded. An entry stays while its fault acts, so that typing in it is not disturbed.
function showBegun(began) {
  const list = $("faults-begun");
  if (list.children.length > began.length) list.replaceChildren();
  began.forEach((fault, index) => {
    const entry = list.children[index], ended = fault.end_s !== undefined;
    if (entry && entry.classList.contains("ended") === ended) return;
    const fresh = begunEntry(fault, index, ended);
    if (entry) entry.replaceWith(fresh); else list.append(fresh);
  });
  noteActs(began);
  const acting = began.filter(fault => fault.end_s === undefined).length;
  $("faults-count").textContent = acting ? `${acting} active` : "";
  allowFaults(live.holder === "you");
}

// Adds begin and end of each fault to the events, so that plots and list show them.
function noteActs(began) {
  const note = (index, kind, t_s, what) => {
    const key = `${index} ${what}`;
    if (t_s === undefined || faults.told.has(key)) return;
    faults.told.add(key);
    view.head.events.push({ t: t_s * NS, kind: "FAULT", words: `${kind} ${what} by hand`, weight: 1, basis: [] });
  };
  began.forEach((fault, index) => { note(index, fault.kind, fault.start_s, "begins"); note(index, fault.kind, fault.end_s, "ends"); });
  view.head.events.sort((a, b) => a.t - b.t);
}

function begunEntry(fault, index, ended) {
  const { kind, start_s, end_s, ...given } = fault, entry = document.createElement("li"), name = document.createElement("b");
  name.textContent = kind;
  entry.append(name, ended ? ` from ${start_s.toFixed(2)} s to ${end_s.toFixed(2)} s ` : ` since ${start_s.toFixed(2)} s `);
  entry.classList.toggle("ended", ended);
  if (ended) { entry.append(Object.entries(given).map(([key, value]) => `${key} ${typeof value === "object" ? JSON.stringify(value) : value}`).join(", ")); return entry; }
  const form = faultForm(faults.byName.get(kind), given, "Set"), stop = document.createElement("button");
  form.onsubmit = event => { event.preventDefault(); tellFault({ act: "set", index, values: valuesOf(form) }); };
  if (!form.querySelector("[name]")) form.lastChild.remove();
  stop.type = "button"; stop.textContent = "Stop"; stop.className = "stop";
  stop.onclick = () => tellFault({ act: "stop", index });
  form.append(stop);
  entry.append(form);
  return entry;
}

function searchFaults() {
  const words = $("fault-search").value.toLowerCase().split(/\s+/).filter(Boolean);
  let heading = null, shown = 0;
  const close = () => { if (heading) heading.hidden = !shown; };
  for (const each of $("fault-kinds").children) {
    if (each.tagName === "H3") { close(); heading = each; shown = 0; continue; }
    each.hidden = !words.every(word => each.dataset.text.includes(word));
    shown += !each.hidden;
  }
  close();
}

function allowFaults(mine) {
  for (const each of $("tab-faults").querySelectorAll("form :is(input, select, button)")) each.disabled = !mine || live.ended;
}
