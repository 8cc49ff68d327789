/** Inflates the report's arrays. */
import type { Packed } from "./data";

export type Numbers = Uint8Array | Int8Array | Int16Array | Uint16Array | Int32Array | Float32Array;

const KINDS = {
  int8: Int8Array, uint8: Uint8Array, int16: Int16Array, uint16: Uint16Array, int32: Int32Array, float32: Float32Array,
} as const;

/** Return the bytes of base64 of zlib. */
async function inflate(text: string): Promise<Uint8Array> {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Return text in base64 of zlib. */
export async function unpackText(text: string): Promise<string> {
  return new TextDecoder().decode(await inflate(text));
}

/** Return the numbers of a packed array, in the order of its shape. */
export async function unpack({ dtype, shape, delta, data }: Packed): Promise<Numbers> {
  const count = shape.reduce((product, size) => product * size, 1);
  const width = KINDS[dtype].BYTES_PER_ELEMENT;
  const bytes = data ? await inflate(data) : new Uint8Array(0);
  if (bytes.length !== count * width) throw new Error(`an array of ${count} numbers has ${bytes.length} bytes`);
  // the planes of bytes back into numbers
  const whole = new Uint8Array(count * width);
  for (let byte = 0; byte < width; byte++) {
    for (let i = 0; i < count; i++) whole[i * width + byte] = bytes[byte * count + i]!;
  }
  const numbers = new KINDS[dtype](whole.buffer);
  if (delta !== null) sum(numbers, shape, delta);
  return numbers;
}

/** Sum up along an axis; typed arrays wrap round by themselves. */
function sum(numbers: Numbers, shape: number[], axis: number): void {
  const stride = shape.slice(axis + 1).reduce((product, size) => product * size, 1);
  const block = stride * shape[axis]!;
  for (let start = 0; start < numbers.length; start += block) {
    for (let i = start + stride; i < start + block; i++) numbers[i]! += numbers[i - stride]!;
  }
}
