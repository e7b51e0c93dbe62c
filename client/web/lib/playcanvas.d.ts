import type { Entity, GraphicsDevice } from "playcanvas";
import type { Frame } from "../types/lib/streamlod.js";

export declare class StreamlodSplats {
  constructor(device: GraphicsDevice, entity: Entity);
  take(frame: Frame): void;
  destroy(): void;
}
