import { SplatMesh } from "@sparkjsdev/spark";
import type { Frame } from "../types/lib/streamlod.js";

export declare const DRAWN_AS_TRAINED: { sortRadial: boolean; preBlurAmount: number; blurAmount: number; minAlpha: number; maxStdDev: number };

export declare class StreamlodSplats extends SplatMesh {
  take(frame: Frame): void;
}
