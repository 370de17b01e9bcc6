// Where views come from: program or page; the middle ones first.

const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

/** Codes of pictures below each other in one JPEG, shape (rows, columns, channels). */
async function decoded(bytes, channels) {
  const options = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
  const picture = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }), options);
  const canvas = Object.assign(document.createElement("canvas"), picture);
  Object.assign(canvas, { width: picture.width, height: picture.height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(picture, 0, 0);
  const rgba = context.getImageData(0, 0, canvas.width, canvas.height).data;
  const codes = new Uint8Array((rgba.length / 4) * channels);
  for (let i = 0, to = 0; i < rgba.length; i += 4) {
    for (let c = 0; c < channels; c++) codes[to++] = rgba[i + c];
  }
  return codes.buffer;
}

/** What a page carries: deflated codes in base64, or JPEG; text: gives that of a name. */
export function embedded(text, { coding, channels, has_map }) {
  return {
    async piece(number) {
      const bytes = bytesOf(text(`lf-piece-${number}`));
      return coding === "jpeg" ? decoded(bytes, channels) : inflated(bytes);
    },
    slopeMap: has_map && (() => inflated(bytesOf(text("lf-map")))),
  };
}

/** What a program gives by name. */
export function asked(get, { has_map }) {
  return {
    piece: (number) => get(`views/${number}`),
    slopeMap: has_map && (() => get("map")),
  };
}

export function fetcher(base) {
  return async (name) => {
    const answer = await fetch(new URL(name, base)).catch(() => {
      throw new Error("The program that serves this page does not answer; it may have ended.");
    });
    if (!answer.ok) throw new Error(await answer.text());
    return answer.arrayBuffer();
  };
}

/** Fill codes piece by piece; tell after each which views have come in. */
export async function load(metadata, piece, codes, arrived) {
  const view = codes.length / (metadata.views[0] * metadata.views[1]);
  for (const [number, [first, count]] of metadata.pieces.entries()) {
    const buffer = await piece(number);
    const some = codes instanceof Uint16Array ? new Uint16Array(buffer) : new Uint8Array(buffer);
    if (some.length !== count * view) throw new Error(`Piece ${number} of the views is damaged.`);
    codes.set(some, first * view);
    arrived(first, count);
  }
}
