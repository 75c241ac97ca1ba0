// Numbers and small pieces of HTML.

/** Return a number with six digits, as Python's format "g" writes it, or a dash. */
export function number(value, digits = 6) {
  if (value === undefined || value === null || Number.isNaN(value)) return "–";
  const rounded = Number(value.toPrecision(digits)), size = Math.abs(rounded);
  return size > 0 && size < 1e-4 ? Number(rounded).toExponential() : rounded.toString();
}

/** Return a count with separators. */
export function count(value) { return value.toLocaleString("en-US"); }

/** Return an element with properties and children. */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("data-") || name.startsWith("aria-")) made.setAttribute(name, value);
    else made[name] = value;
  }
  made.append(...children);
  return made;
}

/** Return the rows of a table: a name and a text each. */
export function rows(pairs) {
  return pairs.map(([name, text]) => element("tr", {}, element("th", {}, name), element("td", {}, text)));
}

/** Show a sentence at the bottom of the window for a while. */
export function say(text) {
  const message = document.getElementById("message");
  message.textContent = text;
  message.hidden = false;
  clearTimeout(say.timer);
  say.timer = setTimeout(() => { message.hidden = true; }, 4000);
}
