// The frame of every figure: title, caption, and buttons that give it as SVG, PNG and CSV.

import { html } from "./vendor/lit-html.js";
import { download } from "./api.js";

const STYLES = [
  "fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "stroke-linecap", "stroke-opacity", "opacity",
  "font-family", "font-size", "font-weight", "text-anchor", "dominant-baseline",
];

// A figure; `rows` are those of the CSV, the header first.
export function figure(name, title, caption, drawing, rows) {
  const drawn = (event) => event.currentTarget.closest("figure").querySelector("svg[role=img]"); // not a key in its caption
  const tool = (kind, act) =>
    html`<button class="tool" aria-label="${title} as ${kind}" @click=${act}>${kind}</button>`;
  return html`<figure>
    <figcaption>
      <h3>${title}</h3>
      ${caption ? html`<p>${caption}</p>` : null}
    </figcaption>
    ${drawing}
    <div class="tools">
      ${tool("SVG", (event) => download(`${name}.svg`, alone(drawn(event)), "image/svg+xml"))}
      ${tool("PNG", (event) => asPng(drawn(event)).then((blob) => download(`${name}.png`, blob)))}
      ${tool("CSV", () => download(`${name}.csv`, csv(rows()), "text/csv"))}
    </div>
  </figure>`;
}

export function csv(rows) {
  const cell = (value) => {
    const text = String(value ?? "");
    return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return rows.map((row) => row.map(cell).join(",")).join("\r\n") + "\r\n";
}

// The text of an SVG that looks the same without the page's style sheet.
function alone(svg) {
  const copy = svg.cloneNode(true);
  const originals = [svg, ...svg.querySelectorAll("*")];
  [copy, ...copy.querySelectorAll("*")].forEach((element, i) => {
    const style = getComputedStyle(originals[i]);
    for (const key of STYLES) element.setAttribute(key, style.getPropertyValue(key));
    element.removeAttribute("class");
    element.removeAttribute("tabindex");
  });
  const { width, height } = svg.viewBox.baseVal;
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  copy.setAttribute("width", width);
  copy.setAttribute("height", height);
  const ground = document.createElementNS("http://www.w3.org/2000/svg", "rect");
  ground.setAttribute("width", "100%");
  ground.setAttribute("height", "100%");
  ground.setAttribute("fill", getComputedStyle(svg.closest("figure")).backgroundColor);
  copy.prepend(ground);
  return new XMLSerializer().serializeToString(copy);
}

async function asPng(svg) {
  const image = new Image();
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(alone(svg))}`;
  await image.decode();
  const canvas = document.createElement("canvas");
  const { width, height } = svg.viewBox.baseVal;
  [canvas.width, canvas.height] = [3 * width, 3 * height];
  canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
  return new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
}
