// One parameter: its editor by type, unit, range, doc; what would run again is asked while one types.
import { useEffect, useRef, useState } from "react";
import { edit, forgetPreview, tryEdit } from "../state/actions";
import { useStudio } from "../state/store";
import { seconds } from "../text";
import type { Json, Parameter } from "../types";

// What was typed, as a value; a text that says what is wrong with it otherwise.
export function parse(parameter: Parameter, text: string): { value: Json } | { wrong: string } {
  const trimmed = text.trim();
  if (/^\$\{[A-Za-z_]\w*\}$/.test(trimmed)) return { value: trimmed };
  if (trimmed === "auto" && parameter.auto) return { value: "auto" };
  if ((trimmed === "" || trimmed === "null" || trimmed === "none") && parameter.optional) return { value: null };
  if (!parameter.choices && ["int", "float", "number"].includes(parameter.type)) {
    const value = Number(trimmed);
    if (trimmed === "" || Number.isNaN(value)) return /^[+-]?\.(inf|nan)$/i.test(trimmed) ? { value: trimmed } : { wrong: "a number, please" };
    if (parameter.type === "int" && !Number.isInteger(value)) return { wrong: "a whole number, please" };
    const range = outside(parameter, value);
    return range ? { wrong: range } : { value };
  }
  if (parameter.type === "bool") return trimmed === "true" || trimmed === "false" ? { value: trimmed === "true" } : { wrong: "true or false" };
  if (parameter.choices) return { value: parameter.choices.find((choice) => shown(choice) === text) ?? text };
  if (["list", "map", "any"].includes(parameter.type)) {
    try { return { value: JSON.parse(trimmed) as Json }; } catch { return parameter.type === "any" ? { value: trimmed } : { wrong: parameter.type === "list" ? "a list such as [1, 2]" : 'a map such as {"a": 1}' }; }
  }
  return { value: text };
}

function outside(p: Parameter, value: number): string {
  if (p.ge !== null && value < p.ge) return `at least ${p.ge}`;
  if (p.gt !== null && value <= p.gt) return `more than ${p.gt}`;
  if (p.le !== null && value > p.le) return `at most ${p.le}`;
  if (p.lt !== null && value >= p.lt) return `less than ${p.lt}`;
  return "";
}

export function rangeOf(p: Parameter): string {
  const low = p.ge !== null ? `from ${p.ge}` : p.gt !== null ? `above ${p.gt}` : "", high = p.le !== null ? `to ${p.le}` : p.lt !== null ? `below ${p.lt}` : "";
  return [low, high].filter(Boolean).join(" ");
}

const shown = (value: Json): string => (value === null ? "" : typeof value === "string" ? value : JSON.stringify(value));

export function Field({ parameter, target, readOnly }: { parameter: Parameter; target: string; readOnly: boolean }) {
  const [text, setText] = useState(() => shown(parameter.value)), [wrong, setWrong] = useState("");
  const timer = useRef(0), typing = useRef(false);
  useEffect(() => { if (!typing.current) { setText(shown(parameter.value)); setWrong(""); } }, [parameter.value]);
  const preview = useStudio((s) => (s.preview?.for === target ? s.preview : null));
  const marked = useStudio((s) => s.marked.has(target));

  const change = (next: string) => {
    typing.current = true;
    setText(next);
    const parsed = parse(parameter, next);
    setWrong("wrong" in parsed ? parsed.wrong : "");
    clearTimeout(timer.current);
    if ("value" in parsed && JSON.stringify(parsed.value) !== JSON.stringify(parameter.value)) timer.current = window.setTimeout(() => void tryEdit(target, { set: target, to: parsed.value }), 250);
    else forgetPreview();
  };
  const commit = (next = text) => {
    clearTimeout(timer.current);
    const parsed = parse(parameter, next);
    typing.current = false;
    forgetPreview();
    if ("wrong" in parsed) { setWrong(parsed.wrong); return; }
    if (JSON.stringify(parsed.value) === JSON.stringify(parameter.value)) { setText(shown(parameter.value)); return; }
    void edit({ set: target, to: parsed.value }).then((done) => { if (!done) setText(shown(parameter.value)); });
  };
  const abandon = () => { typing.current = false; clearTimeout(timer.current); forgetPreview(); setText(shown(parameter.value)); setWrong(""); };

  const id = `p-${target}`, number = ["int", "float", "number"].includes(parameter.type);
  const bounded = number && parameter.le !== null && (parameter.ge !== null || parameter.gt !== null) && parameter.le - (parameter.ge ?? parameter.gt ?? 0) <= 100 && typeof parameter.value === "number";
  let control;
  const choices = parameter.choices ?? (parameter.type === "bool" && parameter.auto ? [true, false, "auto"] : null);
  if (parameter.type === "bool" && !choices) control = <input id={id} type="checkbox" disabled={readOnly} checked={parameter.value === true} onChange={(event) => void edit({ set: target, to: event.target.checked })} />;
  else if (choices) control = (
    <select id={id} disabled={readOnly} value={shown(parameter.value)} onChange={(event) => commit(event.target.value)}>
      {!choices.some((choice) => shown(choice) === shown(parameter.value)) && <option>{shown(parameter.value)}</option>}
      {choices.map((choice) => <option key={shown(choice)} value={shown(choice)}>{shown(choice)}</option>)}
    </select>
  );
  else control = (
    <input id={id} type="text" inputMode={number ? "decimal" : "text"} readOnly={readOnly} value={text} spellCheck={false} autoComplete="off" aria-invalid={wrong !== ""} placeholder={parameter.optional ? "none" : ""}
      onChange={(event) => change(event.target.value)} onBlur={() => { if (typing.current) commit(); }}
      onKeyDown={(event) => {
        if (event.key === "Enter") { commit(); }
        if (event.key === "Escape") { abandon(); event.stopPropagation(); }
        if (number && (event.key === "ArrowUp" || event.key === "ArrowDown") && text.trim() !== "" && Number.isFinite(Number(text))) {
          event.preventDefault();
          change(String(stepped(parameter, Number(text), event.key === "ArrowUp" ? 1 : -1)));
        }
      }} />
  );
  return (
    <div className={`field${parameter.set ? " set" : ""}${wrong ? " wrong" : ""}`}>
      <label htmlFor={id} title={parameter.doc}>{parameter.name}</label>
      <span className="control">
        {control}
        {parameter.unit && <span className="unit">{parameter.unit}</span>}
        {parameter.set && !readOnly && <button className="quiet" title={`back to ${shown(parameter.default) || "none"}`} aria-label={`reset ${parameter.name}`} onClick={() => void edit({ unset: target })}>↺</button>}
        {!readOnly && parameter.type === "bool" && !choices && <span className="fill" />}
      </span>
      {bounded && !readOnly && <input type="range" className="slider" aria-label={`${parameter.name}, slider`} min={parameter.ge ?? parameter.gt ?? 0} max={parameter.le!} step={parameter.type === "int" ? 1 : (parameter.le! - (parameter.ge ?? parameter.gt ?? 0)) / 100}
        value={Number(text) || 0} onChange={(event) => change(String(Number(Number(event.target.value).toPrecision(4))))} onPointerUp={(event) => commit((event.target as HTMLInputElement).value && String(Number(Number((event.target as HTMLInputElement).value).toPrecision(4))))} onKeyUp={() => commit()} />}
      {wrong && <p className="wrong-why" role="alert">{wrong}</p>}
      {preview && <p className="again-why" role="status">{preview.run ? `would run again: ${preview.run} nodes, about ${seconds(preview.seconds) || "?"}` : "nothing would run again"}</p>}
      <p className="doc">
        {parameter.doc}{" "}
        <span className="soft">{[rangeOf(parameter), parameter.auto ? `or auto, by ${parameter.auto}` : "", parameter.reference ? `now ${parameter.reference}` : "", parameter.tuning ? "changes no result" : "", parameter.rounds_differ ? "other values in some rounds" : "", !parameter.required && shown(parameter.default) !== shown(parameter.value) ? `default ${shown(parameter.default) || "none"}` : ""].filter(Boolean).join(" · ")}</span>
        {marked && <span className="soft"> · ◆ marked</span>}
      </p>
    </div>
  );
}

function stepped(p: Parameter, value: number, way: number): number {
  const size = p.type === "int" ? Math.max(p.multiple_of ?? 1, 10 ** Math.max(0, Math.floor(Math.log10(Math.abs(value) || 1)) - 1)) : 10 ** (Math.floor(Math.log10(Math.abs(value) || 0.1)) - 1);
  const next = Number((value + way * size).toPrecision(6));
  return Math.min(p.le ?? Infinity, Math.max(p.ge ?? -Infinity, next));
}
