// Unpacks the modules that a page holds and starts the last of them: no server, no network.
window.unpack = async (text) => {
  const letters = atob(text);
  const packed = new Uint8Array(letters.length);
  for (let i = 0; i < packed.length; i++) packed[i] = letters.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};
(async () => {
  const urls = {};
  let last;
  for (const holder of document.querySelectorAll('script[data-module]')) {
    let source = new TextDecoder().decode(await window.unpack(holder.textContent));
    for (const [name, url] of Object.entries(urls)) source = source.replace(`'${name}'`, `'${url}'`);
    last = URL.createObjectURL(new Blob([source], { type: 'text/javascript' }));
    urls[holder.dataset.module] = last;
  }
  await import(last);
})();
