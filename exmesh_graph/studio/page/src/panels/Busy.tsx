// The sign of what runs: it turns when there is news, not by itself, since each picture of a moving sign costs the run time.
import { useStudio } from "../state/store";

export function Busy() {
  const beat = useStudio((s) => s.beat);
  return <i className="spin" style={{ transform: `rotate(${(beat % 8) * 45}deg)` }} />;
}
