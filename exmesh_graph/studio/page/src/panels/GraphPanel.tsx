// Nothing selected: the graph's own parameters and faults, or the run whose graph is shown.
import { useStudio } from "../state/store";
import { Field } from "./Field";
import { ProblemList } from "./Problems";
import { RunCard } from "./Runs";

export function GraphPanel() {
  const document = useStudio((s) => s.document)!, runGraph = useStudio((s) => s.runGraph), details = useStudio((s) => s.details), fresh = useStudio((s) => s.runs.length === 0 && s.awaiting === null);
  return (
    <div className="scroll">
      {runGraph && <div className="head"><h2>A run's own graph</h2><p className="doc">This is how that run ran it; it cannot be edited.</p></div>}
      {!runGraph && (
        <div className="head">
          <h2>{document.name}{document.variant && <span className="chip">{document.variant}</span>}</h2>
          {document.doc && <p className="doc">{document.doc}</p>}
        </div>
      )}
      {fresh && <p className="comment hint">Press <b>▶ Run</b>: every box runs once and keeps what it made. Then click a box to look at its results or to change it; what would run again is marked at once. <b>?</b> tells all keys and signs.</p>}
      {details && <RunCard run={details} />}
      {!runGraph && document.problems.length > 0 && <ProblemList problems={document.problems} />}
      {!runGraph && (
        <div className="parameters">
          <h3>Parameters of the graph</h3>
          {document.params.length === 0 && <p className="soft">This file declares none. Select a node to see its own.</p>}
          {document.params.map((parameter) => <Field key={parameter.name} parameter={parameter} target={parameter.target || parameter.name} readOnly={false} />)}
          <h3>Results that are published</h3>
          {document.outputs.length === 0 && <p className="soft">none</p>}
          {document.outputs.map((output) => <p key={output.name}><b>{output.name}</b> <span className="soft">{output.node}.{output.port}</span></p>)}
        </div>
      )}
    </div>
  );
}
