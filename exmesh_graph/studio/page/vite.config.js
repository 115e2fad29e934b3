// Builds ../static, which is checked in and ships in the wheel: `npm ci && npm run build`.
import { fileURLToPath } from "node:url";
import react from "@vitejs/plugin-react";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));

export default {
  base: "/static/",
  plugins: [react()],
  resolve: {
    alias: [
      { find: "viewer", replacement: here("../../report/view/viewer.js") },
      { find: "orbit", replacement: here("node_modules/three/examples/jsm/controls/OrbitControls.js") },
      { find: /^three$/, replacement: here("node_modules/three/build/three.module.js") },
    ],
  },
  build: {
    outDir: here("../static"),
    emptyOutDir: true,
    target: "es2022",
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    license: { fileName: "licences.md" },
    chunkSizeWarningLimit: 1000,
  },
};
