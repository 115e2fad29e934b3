// Keys that work wherever no text is typed.
import { lookAtNode } from "./panels/Results";
import { toggleMark } from "./panels/NodeHead";
import { edit, redo, startRun, undo } from "./state/actions";
import { isBypassed } from "./graph/states";
import { nodeOf, now, roundsOf, set } from "./state/store";

export function keys(event: KeyboardEvent): void {
  const target = event.target as HTMLElement, typing = target.closest("input:not([type=range]):not([type=checkbox]), textarea, select, [contenteditable]");
  const command = event.ctrlKey || event.metaKey, s = now(), key = event.key.toLowerCase();
  if (s.overlay) return; // a window has the keys
  const done = () => event.preventDefault();
  if (command && key === "enter") { done(); (document.activeElement as HTMLElement | null)?.blur(); if (!s.busy) void startRun(); return; }
  if (command && key === "s") { done(); if (s.document?.dirty) set({ overlay: "save" }); return; }
  if (typing) return;
  if (command && key === "z") { done(); void (event.shiftKey ? redo() : undo()); return; }
  if (command && key === "y") { done(); void redo(); return; }
  if (command || event.altKey) return;
  const node = nodeOf(s, s.selected), edits = s.runGraph === null;
  if (key.startsWith("arrow") && !target.closest(".dock, .inspector, .top, [role=tablist]")) { done(); window.dispatchEvent(new CustomEvent("studio:walk", { detail: event.key })); }
  else if (key === "escape") { if (s.dock === "full") set({ dock: "open" }); else set({ selected: null, preview: null }); }
  else if (key === "?") { done(); set({ overlay: "help" }); }
  else if ((key === "a" || key === "/") && edits) { done(); set({ overlay: "add", addAt: null }); }
  else if (key === "l") set({ dock: s.dock === "full" ? "open" : "full", tab: "look" });
  else if (key === "f") document.querySelector<HTMLButtonElement>(".react-flow__controls-fitview")?.click();
  else if (node && key === "m") toggleMark(node.id);
  else if (node && edits && key === "b" && node.editable.includes("bypass")) { const rounds = roundsOf(node), round = rounds.length > 1 ? s.round : null; void edit({ [isBypassed(node, round) ? "restore" : "bypass"]: round ? rounds[round - 1] : node.id }); }
  else if (node && edits && (key === "delete" || key === "backspace") && node.editable.includes("remove")) { done(); void edit({ remove: node.id, force: true }); }
  else if (node && key === "enter" && !target.closest("button, a")) lookAtNode(node);
}
