// Reads an MP4 file with mp4box.js, writes it again, and cuts it into other segments: mp4_tools.mjs IN AGAIN CUT
import { readFileSync, writeFileSync } from "node:fs";
import { createFile, DataStream } from "mp4box";

const [source, again, cut] = process.argv.slice(2);
const bytes = readFileSync(source);

function parsed(onReady) {
  const file = createFile(true);
  file.onReady = (info) => onReady?.(file, info);
  const data = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
  data.fileStart = 0;
  return { file, feed: () => (file.appendBuffer(data), file.flush()) };
}

const whole = parsed();
whole.feed();
const stream = new DataStream();
whole.file.write(stream);
writeFileSync(again, Buffer.from(stream.buffer));

const parts = [];
const other = parsed((file, info) => {
  for (const track of info.tracks) file.setSegmentOptions(track.id, null, { nbSamples: 7 });
  parts.push(Buffer.from(file.initializeSegmentation().buffer));
  file.start();
});
other.file.onSegment = (_track, _user, data) => parts.push(Buffer.from(data));
other.feed();
writeFileSync(cut, Buffer.concat(parts));

const told = [];
const samples = parsed((file, info) => {
  for (const track of info.tracks) file.setExtractionOptions(track.id, null, { nbSamples: 10 ** 6 });
  told.push(...info.tracks.map((track) => ({ codec: track.codec })));
  file.start();
});
samples.file.onSamples = (track, _user, found) => {
  Object.assign(told[track - 1], { samples: found.length, sync: found.filter((s) => s.is_sync).map((s) => s.dts) });
};
samples.feed();
console.log(JSON.stringify(told));
