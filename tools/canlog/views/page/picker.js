// The list of all signals, filtered while the user types.

let picked = 0;

function openPicker() {
  $("picker").showModal();
  $("picker-search").value = "";
  fillPicker();
  $("picker-search").focus();
}

function preparePicker() {
  const field = $("picker-search");
  field.oninput = fillPicker;
  field.onkeydown = event => {
    const rows = [...$("picker-list").children];
    if (event.key === "ArrowDown" || event.key === "ArrowUp") {
      event.preventDefault();
      picked = Math.min(Math.max(picked + (event.key === "ArrowDown" ? 1 : -1), 0), rows.length - 1);
      choose(rows);
    } else if (event.key === "Enter" && rows[picked]) { event.preventDefault(); take(rows[picked].dataset.name, event.shiftKey); }
  };
  $("picker").addEventListener("click", event => { if (event.target === $("picker")) $("picker").close(); });
}

function fillPicker() {
  const words = $("picker-search").value.toLowerCase().split(/\s+/).filter(Boolean);
  const found = view.signals.filter(signal => words.every(word => `${signal.full} ${signal.comment}`.toLowerCase().includes(word)));
  const shown = new Set(view.panels.flat());
  picked = 0;
  $("picker-list").replaceChildren(...found.slice(0, 300).map(signal => {
    const row = document.createElement("li"), [message, name] = signal.full.split(/\.(.*)/);
    row.dataset.name = signal.full; row.role = "option";
    row.classList.toggle("on", shown.has(signal.full));
    row.innerHTML = '<span><span class="msg"></span><b></b></span><span class="c"></span>';
    row.querySelector(".msg").textContent = `${message}.`;
    row.querySelector("b").textContent = name;
    row.querySelector(".c").textContent = [signal.unit, signal.comment].filter(Boolean).join(" · ");
    row.onclick = event => take(signal.full, event.shiftKey);
    return row;
  }));
  choose([...$("picker-list").children]);
}

function choose(rows) {
  rows.forEach((row, at) => row.setAttribute("aria-selected", at === picked));
  rows[picked]?.scrollIntoView({ block: "nearest" });
}

function take(name, intoLast) {
  $("picker").close();
  changePanels(all => intoLast && all.length ? [...all.slice(0, -1), [...new Set([...all.at(-1), name])]] : [...all, [name]]);
  $("panels").scrollTop = $("panels").scrollHeight;
}
