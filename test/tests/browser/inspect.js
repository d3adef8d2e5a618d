// Checks the page for faults that a reader would notice, and counts the texts and figures checked.
(() => {
  const problems = [];
  const rgba = text => {
  const n = text.match(/[\d.]+/g).map(Number);
  return n.length > 3 ? n : [...n, 1];
  };
  const luminance = c => {
    const linear = v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
    const [r, g, b] = c.slice(0, 3).map(v => linear(v / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const contrast = (a, b) => {
    const [x, y] = [luminance(a), luminance(b)];
    return (Math.max(x, y) + 0.05) / (Math.min(x, y) + 0.05);
  };
  const behind = element => {
    for (let e = element; e; e = e.parentElement) {
      const c = rgba(getComputedStyle(e).backgroundColor);
      if (c[3] > 0) return c;
    }
    return [255, 255, 255, 1];
  };
  let texts = 0;
  const words = node => node.textContent.trim().replace(/\s+/g, ' ').slice(0, 40);
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!words(walker.currentNode) || element.closest('svg')) continue;
    texts++;
    const style = getComputedStyle(element);
    const found = contrast(rgba(style.color), behind(element));
    const what = words(walker.currentNode);
    if (found < 4.5) problems.push(`contrast ${found.toFixed(2)} of "${what}"`);
    if (parseFloat(style.fontSize) < 12) problems.push(`text of ${style.fontSize}: "${what}"`);
  }
  let figures = 0;
  for (const figure of document.querySelectorAll('figure')) {
    const svg = figure.querySelector('svg');
    const name = svg?.getAttribute('aria-label') ?? 'a figure without a name';
    const box = svg?.getBoundingClientRect() ?? {width: 0, height: 0};
    figures++;
    if (!svg || box.width < 300 || box.height < 100) {
    problems.push(`${name} is ${box.width}x${box.height}`);
    continue;
    }
    const ground = rgba(getComputedStyle(svg.querySelector('rect')).fill);
    const scale = box.width / svg.viewBox.baseVal.width;
    const boxes = [];
    for (const text of svg.querySelectorAll('text')) {
      if (!words(text)) continue;
      texts++;
      const style = getComputedStyle(text);
      const found = contrast(rgba(style.fill), ground);
      if (found < 4.5) problems.push(`${name}: contrast ${found.toFixed(2)} of "${words(text)}"`);
      const size = parseFloat(style.fontSize) * scale;
      if (size < 10.5) problems.push(`${name}: tiny "${words(text)}"`);
      const b = text.getBoundingClientRect();
      const across = b.left < box.left - 1 || b.right > box.right + 1;
      if (across || b.top < box.top - 1 || b.bottom > box.bottom + 1)
        problems.push(`${name}: "${words(text)}" is cut off`);
      for (const [other, o] of boxes) {
        const across = Math.min(b.right, o.right) - Math.max(b.left, o.left);
        const down = Math.min(b.bottom, o.bottom) - Math.max(b.top, o.top);
        // A line of text has empty space above and below its letters.
        if (across > 2 && down > 0.45 * Math.min(b.height, o.height))
          problems.push(`${name}: "${words(text)}" lies on "${words(other)}"`);
      }
      boxes.push([text, b]);
    }
    // Lines and bars must differ from the ground; grid and shade need not.
    for (const mark of svg.querySelectorAll('polyline, circle, polygon')) {
      const style = getComputedStyle(mark);
      const color = style.fill !== 'none' ? style.fill : style.stroke;
      if (color === 'none' || mark.closest('[data-soft]')) continue;
      const c = rgba(color);
      if (c[3] > 0.5 && contrast(c, ground) < 1.02)
      problems.push(`${name}: a mark of the ground's color ${color}`);
    }
  }
  const wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  if (wide > 0) problems.push(`the page is ${wide} px wider than its window`);
  return {
    problems: [...new Set(problems)], texts, figures,
    ground: getComputedStyle(document.body).backgroundColor,
  };
})()
