import { createRoot } from "react-dom/client";
import "@xyflow/react/dist/base.css";
import "./style/base.css";
import "./style/graph.css";
import "./style/panels.css";
import "./style/look.css";
import { App } from "./App";

createRoot(document.getElementById("root")!).render(<App />);
