// Numbers as people read them.
import type { Json } from "./types";

export function seconds(value: number | null | undefined): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "";
  if (value < 0.95) return value < 0.1 ? "<0.1 s" : `${value.toFixed(1)} s`;
  if (value < 9.95) return `${value.toFixed(1)} s`;
  if (value < 99.5) return `${Math.round(value)} s`;
  const minutes = Math.floor(value / 60), rest = Math.round(value % 60);
  if (minutes < 60) return rest ? `${minutes} min ${rest} s` : `${minutes} min`;
  return `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

export function bytes(value: number | null | undefined): string {
  if (!value) return "";
  const units = ["B", "kB", "MB", "GB", "TB"];
  let size = value, k = 0;
  while (size >= 999.5 && k < units.length - 1) { size /= 1000; k++; }
  return `${size >= 99.5 || k === 0 ? Math.round(size) : size.toFixed(1)} ${units[k]}`;
}

export function figure(value: Json | undefined, digits = 4): string {
  if (value === null || value === undefined) return "–";
  if (typeof value !== "number") return typeof value === "object" ? JSON.stringify(value) : String(value);
  if (Number.isInteger(value)) return String(value).replace(/\B(?=(\d{3})+$)/g, "\u202f");
  const size = Math.abs(value);
  if (size >= 0.001 && size < 1e6) return String(Number(value.toPrecision(digits)));
  return value.toExponential(2);
}

export const count = (n: number, one: string, many = `${one}s`) => `${n} ${n === 1 ? one : many}`;

export function ago(time: number): string {
  const past = Date.now() / 1000 - time;
  if (past < 60) return "just now";
  if (past < 3600) return `${Math.floor(past / 60)} min ago`;
  if (past < 86400) return `${Math.floor(past / 3600)} h ago`;
  return new Date(time * 1000).toLocaleDateString("en", { day: "numeric", month: "short" });
}
