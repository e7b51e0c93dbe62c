import { Group } from "three/webgpu";
import type { Frame } from "../types/lib/streamlod.js";

export declare class StreamlodSplats extends Group {
  take(frame: Frame): void;
  dispose(): void;
}
