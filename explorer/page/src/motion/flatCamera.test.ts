import { PerspectiveCamera, Vector3 } from "three";
import { expect, test } from "vitest";

import { FIELD_OF_VIEW } from "./actors";
import { FlatCamera } from "./flatCamera";

test("places are where a camera of three.js has them", () => {
  const camera = new FlatCamera();
  const [width, height] = [800, 500];
  Object.assign(camera, { width, height, target: [1.5, 0.95, -2] });
  const out = new Float32Array(3);
  for (const [yaw, pitch, closer] of [[0, 0, 1], [0.7, 0.3, 0.8], [2.9, -0.2, 1.6], [-1.2, 0.9, 1]] as const) {
    camera.turn(yaw, pitch, closer);
    camera.aim();
    const twin = new PerspectiveCamera(FIELD_OF_VIEW, width / height, 0.05, 200);
    const target = new Vector3(...camera.target);
    const { yaw: turned, pitch: tilted, distance } = camera;
    const level = Math.cos(tilted) * distance;
    const away = [Math.sin(turned) * level, Math.sin(tilted) * distance, Math.cos(turned) * level] as const;
    twin.position.copy(target).add(new Vector3(...away));
    twin.lookAt(target);
    twin.updateMatrixWorld();
    for (const place of [[1.5, 0.95, -2], [1, 0, -2.5], [2.2, 1.7, -1.1]] as const) {
      const seen = new Vector3(...place).project(twin);
      camera.project(place[0], place[1], place[2], out, 0);
      expect(out[0]).toBeCloseTo((0.5 + 0.5 * seen.x) * width, 1);
      expect(out[1]).toBeCloseTo((0.5 - 0.5 * seen.y) * height, 1);
      const depth = -new Vector3(...place).applyMatrix4(twin.matrixWorldInverse).z;
      expect(out[2]).toBeCloseTo(depth, 3);
      expect(camera.pixels(1, out[2] as number)).toBeGreaterThan(0);
    }
  }
});
