// Requests to the server. Every failure is a Refusal with the server's own words: what, where, how to mend it.
import type { Json, Problem } from "./types";

export class Refusal extends Error {
  constructor(readonly status: number, readonly code: string, what: string, readonly where = "", readonly fix = "", readonly problems: Problem[] = []) {
    super(what);
  }
}

export const NO_SERVER = 0;

async function answer(response: Response): Promise<Response> {
  if (response.ok) return response;
  let told: { what?: string; where?: string; fix?: string; code?: string; problems?: Problem[] } = {};
  try { told = (await response.json()).error ?? {}; } catch { /* no JSON: the status must do */ }
  const problems = told.problems ?? [];
  throw new Refusal(response.status, told.code ?? "", told.what || problems[0]?.what || `the server answered ${response.status}`, told.where, told.fix || problems[0]?.fix, problems);
}

async function reach(path: string, init?: RequestInit): Promise<Response> {
  try {
    return await answer(await fetch(path, { credentials: "same-origin", ...init }));
  } catch (error) {
    if (error instanceof Refusal || (error instanceof DOMException && error.name === "AbortError")) throw error;
    throw new Refusal(NO_SERVER, "unreachable", "The server does not answer.", "", "Start exmesh studio again; runs go on without it.");
  }
}

export type Query = { [name: string]: string | number | boolean | undefined | string[] };

export function address(path: string, query: Query = {}): string {
  const parts = new URLSearchParams();
  for (const [name, value] of Object.entries(query)) {
    if (Array.isArray(value)) for (const item of value) parts.append(name, item);
    else if (value !== undefined) parts.append(name, String(value));
  }
  const text = parts.toString();
  return text ? `${path}?${text}` : path;
}

export async function get<T>(path: string, query: Query = {}, signal?: AbortSignal): Promise<T> {
  return (await reach(address(path, query), { signal })).json() as Promise<T>;
}

export async function getBytes(path: string, query: Query = {}, signal?: AbortSignal): Promise<{ bytes: Uint8Array; headers: Headers }> {
  const response = await reach(address(path, query), { signal });
  return { bytes: new Uint8Array(await response.arrayBuffer()), headers: response.headers };
}

export async function post<T>(path: string, body: { [name: string]: Json | undefined }, signal?: AbortSignal): Promise<T> {
  const response = await reach(path, { method: "POST", headers: { "Content-Type": "application/json", "X-Exmesh": "1" }, body: JSON.stringify(body), signal });
  return response.json() as Promise<T>;
}
