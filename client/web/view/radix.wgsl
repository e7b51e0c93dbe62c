// Keys of 24 bits and their numbers in ascending order, equal keys as they came: three passes over 8 bits each. A block
// counts its digits, one workgroup adds up where each block's go, and the block moves them there.

override SHIFT: u32 = 0;          // of a pass's digit
override IS_FIRST: bool = false;  // of the passes: there may be keys that are left out
override QUADS: u32 = 1;          // that one instance draws
const THREADS = 256u; // as many as digits
const ROUNDS = 16u;   // of a block: elements that a thread sees
const WORDS = 8u;     // of 32 bits: one bit a thread
const LEFT_OUT = 0xffffffffu;

struct Sizes {
  indices: u32, instances: u32, firstIndex: u32, baseVertex: u32, firstInstance: u32, // of the draw
  count: u32, // elements before the first pass
  shown: u32, // and after it
}

@group(0) @binding(0) var<storage, read> keys: array<u32>;
@group(0) @binding(1) var<storage, read> numbers: array<u32>;
@group(0) @binding(2) var<storage, read_write> sortedKeys: array<u32>;
@group(0) @binding(3) var<storage, read_write> sortedNumbers: array<u32>;
@group(0) @binding(4) var<storage, read_write> places: array<u32>; // by block and digit: how many; then where the next goes
@group(0) @binding(5) var<storage, read_write> sizes: Sizes;

var<workgroup> digits: array<atomic<u32>, THREADS>;
var<workgroup> sums: array<u32, THREADS>;
var<workgroup> masks: array<atomic<u32>, WORDS * THREADS>; // of a round, by word and digit: threads that have it

fn elements() -> u32 {
  return select(sizes.shown, sizes.count, IS_FIRST);
}

fn digitOf(key: u32) -> u32 {
  return (key >> SHIFT) & (THREADS - 1u);
}

/// The key there; LEFT_OUT beyond the end.
fn keyAt(i: u32) -> u32 {
  if (i < elements()) {
    return keys[i];
  }
  return LEFT_OUT;
}

@compute @workgroup_size(THREADS)
fn count(@builtin(workgroup_id) block: vec3u, @builtin(local_invocation_index) thread: u32) {
  for (var round = 0u; round < ROUNDS; round++) {
    let key = keyAt((block.x * ROUNDS + round) * THREADS + thread);
    if (key != LEFT_OUT) {
      atomicAdd(&digits[digitOf(key)], 1u);
    }
  }
  workgroupBarrier();
  places[block.x * THREADS + thread] = atomicLoad(&digits[thread]);
}

@compute @workgroup_size(THREADS)
fn add(@builtin(local_invocation_index) digit: u32) {
  let blocks = (elements() + ROUNDS * THREADS - 1u) / (ROUNDS * THREADS);
  var total = 0u;
  for (var block = 0u; block < blocks; block++) {
    total += places[block * THREADS + digit];
  }
  sums[digit] = total;
  for (var reach = 1u; reach < THREADS; reach *= 2u) { // sums over ever more digits
    workgroupBarrier();
    var lower = 0u;
    if (digit >= reach) {
      lower = sums[digit - reach];
    }
    workgroupBarrier();
    sums[digit] += lower;
  }
  var place = sums[digit] - total;
  for (var block = 0u; block < blocks; block++) {
    let own = places[block * THREADS + digit];
    places[block * THREADS + digit] = place;
    place += own;
  }
  if (IS_FIRST && digit == THREADS - 1u) {
    sizes.shown = sums[digit];
    sizes.instances = (sums[digit] + QUADS - 1u) / QUADS;
  }
}

@compute @workgroup_size(THREADS)
fn scatter(@builtin(workgroup_id) block: vec3u, @builtin(local_invocation_index) thread: u32) {
  let word = thread / 32u;
  let bit = 1u << (thread % 32u);
  var next = places[block.x * THREADS + thread]; // where the next key with the thread's digit goes
  for (var round = 0u; round < ROUNDS; round++) {
    sums[thread] = next;
    for (var w = 0u; w < WORDS; w++) {
      atomicStore(&masks[w * THREADS + thread], 0u);
    }
    workgroupBarrier();
    let i = (block.x * ROUNDS + round) * THREADS + thread;
    let key = keyAt(i);
    let digit = digitOf(key);
    if (key != LEFT_OUT) {
      atomicOr(&masks[word * THREADS + digit], bit);
    }
    workgroupBarrier();
    if (key != LEFT_OUT) { // after those of the threads before that have the same digit
      var place = sums[digit] + countOneBits(atomicLoad(&masks[word * THREADS + digit]) & (bit - 1u));
      for (var w = 0u; w < word; w++) {
        place += countOneBits(atomicLoad(&masks[w * THREADS + digit]));
      }
      sortedKeys[place] = key;
      sortedNumbers[place] = numbers[i];
    }
    for (var w = 0u; w < WORDS; w++) {
      next += countOneBits(atomicLoad(&masks[w * THREADS + thread]));
    }
    workgroupBarrier();
  }
}
