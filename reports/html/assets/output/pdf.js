"use strict";
// PDF of vectors: pictures as plotly draws them (paths, texts, tiles) and words, in the fonts of every reader.

const PT = 0.75; // points of a px
const FONTS = ["Helvetica", "Helvetica-Bold", "Symbol"];
// Octal codes in the font Symbol, and in the encoding of the others.
const SYMBOLS = { "→": "256", "←": "254", "≥": "263", "≤": "243", "≠": "271", "−": "055", μ: "155" };
const WINDOWS = { "…": "205", "–": "226", "—": "227", "‘": "221", "’": "222", "“": "223", "”": "224", "•": "225" };
const CIRCLE_POINTS = 32;

const short = (value) => String(Math.round(1000 * value) / 1000);
/** Widths of the characters from the space on, in thousandths of the size: of Helvetica, and of Helvetica-Bold. */
// prettier-ignore
const ADVANCES = [
  "278 278 355 556 556 889 667 191 333 333 389 584 278 333 278 278 556 556 556 556 556 556 556 556 556 556 " +
  "278 278 584 584 584 556 1015 667 667 722 722 667 611 778 722 278 500 667 556 833 722 778 667 778 722 667 " +
  "611 722 667 944 667 667 611 278 278 278 469 556 333 556 556 500 556 556 278 556 556 222 222 500 222 833 " +
  "556 556 556 556 333 500 278 556 500 722 500 500 500 334 260 334 584",
  "278 333 474 556 556 889 722 238 333 333 389 584 278 333 278 278 556 556 556 556 556 556 556 556 556 556 " +
  "333 333 584 584 584 611 975 722 722 722 722 667 611 778 722 278 556 722 611 833 722 778 667 778 722 667 " +
  "611 722 667 944 667 667 611 333 278 333 584 556 333 556 611 556 611 556 333 611 611 278 278 556 278 889 " +
  "611 611 611 611 389 556 333 611 556 778 556 556 500 389 280 389 584",
].map((line) => line.split(" ").map(Number));
const OTHER_ADVANCES = { "→": 987, "←": 987, "…": 1000, "—": 1000, "•": 350, µ: 556, "·": 278 };

function textWidth(text, size, bold = false) {
  const widths = [...text].map((one) => ADVANCES[Number(bold)][one.codePointAt(0) - 32] ?? OTHER_ADVANCES[one] ?? 570);
  return (size * widths.reduce((sum, width) => sum + width, 0)) / 1000;
}

/** A text as [font, escaped characters, text] runs; null where a character is in no font. */
function runsOf(text, bold) {
  const runs = [];
  for (const character of text.replace(/\s/g, " ")) {
    const code = character.codePointAt(0);
    const isSymbol = character in SYMBOLS;
    const octal = SYMBOLS[character] || WINDOWS[character];
    if (!octal && !(code < 127 || (code > 160 && code < 256))) return null;
    const font = isSymbol ? 2 : Number(bold);
    const named = octal || (code > 126 || "()\\".includes(character) ? code.toString(8).padStart(3, "0") : "");
    const escaped = named ? `\\${named}` : character;
    if (runs.length && runs[runs.length - 1][0] === font) {
      runs[runs.length - 1][1] += escaped;
      runs[runs.length - 1][2] += character;
    } else runs.push([font, escaped, character]);
  }
  return runs;
}

/** The operators of a path or rectangle of SVG. */
function pathOps(shape) {
  if (shape.tagName === "rect") return rectOps(shape.getBBox());
  const d = shape.getAttribute("d");
  if (!d) return "";
  if (/[aqst]/i.test(d)) {
    const length = shape.getTotalLength();
    const points = Array.from({ length: CIRCLE_POINTS }, (_, at) =>
      shape.getPointAtLength((length * at) / CIRCLE_POINTS),
    );
    return `${lineOps(points)}h\n`;
  }
  let [x, y, startX, startY] = [0, 0, 0, 0];
  let ops = "";
  for (const [, letter, text] of d.matchAll(/([mlhvcz])([^mlhvcz]*)/gi)) {
    const numbers = (text.match(/[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?/gi) || []).map(Number);
    const kind = letter.toLowerCase();
    const [fromX, fromY] = letter === kind ? [1, 1] : [0, 0]; // relative to the last point
    if (kind === "z") {
      ops += "h\n";
      [x, y] = [startX, startY];
      continue;
    }
    const step = { m: 2, l: 2, h: 1, v: 1, c: 6 }[kind];
    for (let at = 0; at + step <= numbers.length; at += step) {
      const own = numbers.slice(at, at + step);
      const points = kind === "h" ? [own[0], fromY ? 0 : y] : kind === "v" ? [fromX ? 0 : x, own[0]] : own;
      const moved = points.map((value, place) => value + (place % 2 ? fromY * y : fromX * x));
      [x, y] = moved.slice(-2);
      if (kind === "m" && at === 0) [startX, startY] = [x, y];
      ops += `${moved.map(short).join(" ")} ${kind === "m" && at === 0 ? "m" : kind === "c" ? "c" : "l"}\n`;
    }
  }
  return ops;
}

const rectOps = ({ x, y, width, height }) => `${[x, y, width, height].map(short).join(" ")} re\n`;
const lineOps = (points) => points.map(({ x, y }, at) => `${short(x)} ${short(y)} ${at ? "l" : "m"}\n`).join("");

const colorOf = (text) => (/^rgba?\(([^)]*)\)/.exec(text)?.[1].split(/[,\s/]+/) || []).map(Number);

class Pdf {
  constructor() {
    this.objects = [null, null, ...FONTS.map((name) => this.fontOf(name))]; // catalog and pages come last
    this.pages = [];
    this.alphas = new Map();
  }

  fontOf(name) {
    const encoding = name === "Symbol" ? "" : " /Encoding /WinAnsiEncoding";
    return `<< /Type /Font /Subtype /Type1 /BaseFont /${name}${encoding} >>`;
  }

  add(object) {
    return this.objects.push(object);
  }

  async addStream(dictionary, bytes) {
    const packed = new Blob([bytes]).stream().pipeThrough(new CompressionStream("deflate"));
    const body = new Uint8Array(await new Response(packed).arrayBuffer());
    return this.add([`<< ${dictionary} /Filter /FlateDecode /Length ${body.length} >>\nstream\n`, body, "\nendstream"]);
  }

  /** A page of points with parts {svg, left, top} and {words: [{text, size}], left, top, width}. */
  async addPage(width, height, parts) {
    const page = { ops: "", images: [] };
    for (const { svg, words, left, top, width: room } of parts) {
      if (svg) await this.drawSvg(page, svg, `${PT} 0 0 ${-PT} ${left} ${height - top} cm\n`);
      else this.drawWords(page, words, left, height - top, room);
    }
    const content = await this.addStream("", page.ops);
    const images = page.images.map((number) => `/I${number} ${number} 0 R`).join(" ");
    const alphas = [...this.alphas.values()].map((number) => `/A${number} ${number} 0 R`).join(" ");
    const fonts = FONTS.map((_, at) => `/F${at} ${at + 3} 0 R`).join(" ");
    const resources = `<< /Font << ${fonts} >> /XObject << ${images} >> /ExtGState << ${alphas} >> >>`;
    const box = [0, 0, width, height].map(short).join(" ");
    this.pages.push(
      this.add(`<< /Type /Page /Parent 2 0 R /MediaBox [${box}] /Contents ${content} 0 R /Resources ${resources} >>`),
    );
  }

  drawWords(page, words, left, top, room) {
    let y = top;
    for (const { text, size } of words) {
      const lines = [""];
      for (const word of text.split(/\s+/)) {
        const longer = `${lines[lines.length - 1]} ${word}`.trim();
        if (textWidth(longer, size) <= room) lines[lines.length - 1] = longer;
        else lines.push(word);
      }
      for (const line of lines) {
        y -= 1.3 * size;
        const known = [...line].map((one) => (runsOf(one, false) ? one : "?")).join("");
        page.ops += `q 1 0 0 1 ${short(left)} ${short(y)} cm\n0 g\n${this.textOps(known, size, false, 1)}Q\n`;
      }
      y -= 3;
    }
  }

  /** Text at the origin; `up` is -1 where y runs downwards. */
  textOps(text, size, bold, up) {
    let x = 0;
    return runsOf(text, bold)
      .map(([font, escaped, own]) => {
        const ops = `BT /F${font} ${short(size)} Tf 1 0 0 ${up} ${short(x)} 0 Tm (${escaped}) Tj ET\n`;
        x += textWidth(own, size, bold);
        return ops;
      })
      .join("");
  }

  async drawSvg(page, text, placing) {
    const host = document.body.appendChild(element("div", { class: "drawn-for-pdf" }));
    const svg = host.appendChild(
      document.adoptNode(new DOMParser().parseFromString(text, "image/svg+xml").documentElement),
    );
    try {
      page.ops += `q\n${placing}`;
      await this.draw(page, svg, svg, svg.getScreenCTM().inverse(), 1);
      page.ops += "Q\n";
    } finally {
      host.remove();
    }
  }

  async draw(page, svg, node, toPage, alphaAbove) {
    const style = getComputedStyle(node);
    if (style.display === "none" || ["defs", "style", "title"].includes(node.tagName)) return;
    const alpha = alphaAbove * Number(style.opacity);
    const matrix = node.getScreenCTM ? toPage.multiply(node.getScreenCTM()) : null;
    const placed = matrix && [matrix.a, matrix.b, matrix.c, matrix.d, matrix.e, matrix.f].map((one) => one.toFixed(5));
    const clip = /#([^"')]+)/.exec(node.getAttribute("clip-path") || style.clipPath);
    const shape = clip && svg.querySelector(`#${CSS.escape(clip[1])} > *`);
    if (shape) {
      const back = matrix.inverse();
      const away = [back.a, back.b, back.c, back.d, back.e, back.f].map((one) => one.toFixed(5));
      page.ops += `q\n${placed.join(" ")} cm\n${pathOps(shape)}W n\n${away.join(" ")} cm\n`;
    }
    if (style.visibility !== "hidden") {
      const at = `q\n${placed?.join(" ")} cm\n`;
      if (node.tagName === "text") await this.drawText(page, node, at, alpha);
      else if (node.tagName === "image") await this.drawImage(page, node, at);
      else if (["path", "rect"].includes(node.tagName)) this.drawShape(page, node, style, at, alpha);
    }
    if (node.tagName !== "text")
      for (const child of node.children) await this.draw(page, svg, child, toPage, alpha);
    if (shape) page.ops += "Q\n";
  }

  drawShape(page, shape, style, at, alpha) {
    const [fill, stroke] = [style.fill, style.stroke].map(colorOf);
    const crossed = style.fill.startsWith("url"); // a pattern: of bars whose message was lost
    const alphaOf = ([, , , own = 1], share) => alpha * own * Number(share);
    const [filled, drawn] = [alphaOf(fill, style.fillOpacity), alphaOf(stroke, style.strokeOpacity)];
    const paints = [fill.length && filled > 0, stroke.length && drawn > 0 && parseFloat(style.strokeWidth) > 0];
    if (!paints.some(Boolean) && !crossed) return;
    const dashes = style.strokeDasharray === "none" ? [] : style.strokeDasharray.split(/[,\s]+/).map(parseFloat);
    const ops = pathOps(shape);
    const { x, y, width, height } = shape.getBBox();
    const cross = [
      [x, y],
      [x + width, y + height],
      [x, y + height],
      [x + width, y],
    ].map(([left, top], place) => `${short(left)} ${short(top)} ${place % 2 ? "l" : "m"}\n`);
    const even = style.fillRule === "evenodd" ? "*" : "";
    page.ops +=
      `${at}/A${this.alpha(filled, drawn)} gs\n` +
      (paints[0] ? `${fill.slice(0, 3).map((one) => short(one / 255)).join(" ")} rg\n` : "") +
      (paints[1] ? `${stroke.slice(0, 3).map((one) => short(one / 255)).join(" ")} RG\n` : "") +
      `${short(parseFloat(style.strokeWidth))} w [${dashes.map(short).join(" ")}] 0 d\n` +
      `${ops}${crossed ? cross.join("") : ""}` +
      `${paints[0] ? (paints[1] ? `B${even}` : `f${even}`) : paints[1] ? "S" : "n"}\nQ\n`;
  }

  alpha(filled, drawn) {
    const key = `/ca ${short(filled)} /CA ${short(drawn)}`;
    if (!this.alphas.has(key)) this.alphas.set(key, this.add(`<< ${key} >>`));
    return this.alphas.get(key);
  }

  async drawText(page, text, at, alpha) {
    const walker = document.createTreeWalker(text, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) {
      const { data, parentElement: own } = walker.currentNode;
      if (!data.trim() || !own.getNumberOfChars()) continue;
      const style = getComputedStyle(own);
      const [size, bold] = [parseFloat(style.fontSize), Number(style.fontWeight) >= 600];
      // Where the browser's font has other widths than Helvetica, the anchor stays.
      const [{ x: left, y }, { x: right }] = [
        own.getStartPositionOfChar(0),
        own.getEndPositionOfChar(own.getNumberOfChars() - 1),
      ];
      const share = { start: 0, middle: 0.5, end: 1 }[style.textAnchor];
      const x = left + share * (right - left - textWidth(data, size, bold));
      const color = colorOf(style.fill).slice(0, 3);
      page.ops += `${at}1 0 0 1 ${short(x)} ${short(y)} cm\n/A${this.alpha(alpha, alpha)} gs\n`;
      page.ops += `${color.map((one) => short(one / 255)).join(" ")} rg\n`;
      page.ops += runsOf(data, bold)
        ? this.textOps(data, size, bold, -1)
        : await this.pictureOfText(page, data, size, bold, style.fill);
      page.ops += "Q\n";
    }
  }

  /** A text of which a character is in none of the fonts. */
  async pictureOfText(page, text, size, bold, color) {
    const [fine, width, height] = [8, textWidth(text, size, bold) + 1, 1.4 * size];
    const canvas = element("canvas", { width: Math.ceil(fine * width), height: Math.ceil(fine * height) });
    const context = canvas.getContext("2d");
    context.fillStyle = "#ffffff";
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.scale(fine, fine);
    context.font = `${bold ? "bold " : ""}${size}px Helvetica, Arial, sans-serif`;
    context.fillStyle = color;
    context.fillText(text, 0, size);
    return this.imageOps(page, canvas, 0, -size, width, height);
  }

  async drawImage(page, image, at) {
    const picture = new Image();
    picture.src = image.getAttribute("href") || image.getAttributeNS("http://www.w3.org/1999/xlink", "href");
    await picture.decode();
    const canvas = element("canvas", { width: picture.naturalWidth, height: picture.naturalHeight });
    const context = canvas.getContext("2d");
    context.fillStyle = "#ffffff";
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.drawImage(picture, 0, 0);
    const { x, y, width, height } = image.getBBox();
    page.ops += `${at}${await this.imageOps(page, canvas, x, y, width, height)}Q\n`;
  }

  async imageOps(page, canvas, x, y, width, height) {
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const colors = data.filter((_, at) => at % 4 < 3);
    const size = `/Width ${canvas.width} /Height ${canvas.height}`;
    const form = `/Type /XObject /Subtype /Image ${size} /ColorSpace /DeviceRGB /BitsPerComponent 8`;
    const number = await this.addStream(form, colors);
    page.images.push(number);
    return `${[width, 0, 0, -height, x, y + height].map(short).join(" ")} cm /I${number} Do\n`;
  }

  async blob() {
    this.objects[0] = "<< /Type /Catalog /Pages 2 0 R >>";
    const pages = this.pages.map((page) => `${page} 0 R`).join(" ");
    this.objects[1] = `<< /Type /Pages /Kids [${pages}] /Count ${this.pages.length} >>`;
    const parts = ["%PDF-1.7\n%\u00e2\u00e3\n"];
    const places = [];
    const sizeOf = (part) => (typeof part === "string" ? new TextEncoder().encode(part).length : part.length);
    let at = sizeOf(parts[0]);
    this.objects.forEach((object, place) => {
      places.push(at);
      const own = [`${place + 1} 0 obj\n`, ...[object].flat(), "\nendobj\n"];
      parts.push(...own);
      at += own.reduce((sum, part) => sum + sizeOf(part), 0);
    });
    const table = places.map((place) => `${String(place).padStart(10, "0")} 00000 n \n`).join("");
    const count = places.length + 1;
    parts.push(`xref\n0 ${count}\n0000000000 65535 f \n${table}trailer\n<< /Size ${count} /Root 1 0 R >>\n`);
    parts.push(`startxref\n${at}\n%%EOF\n`);
    return new Blob(parts, { type: "application/pdf" });
  }
}
