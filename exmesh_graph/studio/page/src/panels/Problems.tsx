// Faults of the graph, in the checks' own words: what, where, expected, how to mend it.
import { set } from "../state/store";
import type { Problem } from "../types";

export function ProblemList({ problems }: { problems: Problem[] }) {
  return (
    <ul className="problems">
      {problems.map((problem, k) => (
        <li key={k}>
          <p><b>⚠ {problem.what}</b>{problem.rounds > 1 ? ` (in ${problem.rounds} rounds)` : ""}</p>
          {problem.expected && <p className="soft">expected {problem.expected}{problem.found ? `, found ${problem.found}` : ""}</p>}
          {problem.fix && <p>{problem.fix}</p>}
          {problem.nearest.length > 0 && <p className="soft">nearest: {problem.nearest.join(", ")}</p>}
          <p className="soft">{problem.where || "your edits"} {problem.node && <button className="link" onClick={() => { set({ selected: problem.node.replace(/\[\d+\]/g, "") }); window.dispatchEvent(new CustomEvent("studio:reveal", { detail: problem.node.replace(/\[\d+\]/g, "") })); }}>{problem.node}</button>}</p>
        </li>
      ))}
    </ul>
  );
}
