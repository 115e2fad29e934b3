// One thing that an artifact shows, by its kind.
import { address } from "../api";
import { bytes, figure } from "../text";
import type { Artifact, Json, Show } from "../types";
import { CurvesOf } from "./Told";
import { FiguresOf, TableOf } from "./Told";
import { Gallery } from "./Gallery";
import { Picture } from "./Picture";
import { Sheet } from "./Sheet";
import { Stage } from "./Stage";
import { useLook } from "./options";

export function ShowView({ artifact, show }: { artifact: Artifact; show: Show }) {
  const look = useLook(), { digest } = artifact;
  const layer = show.layers?.includes(look.layer) ? look.layer : show.layers?.[0];
  switch (show.kind) {
    case "sheet": return <Sheet digest={digest} show={show} />;
    case "model": case "points": case "cameras": return <Stage digest={digest} show={show} />;
    case "picture": return <Picture source={address("/api/artifact/picture", { digest, show: show.id, ...(layer ? { layer } : {}), size: 0 })} quick={address("/api/artifact/picture", { digest, show: show.id, ...(layer ? { layer } : {}), size: 512 })} title={show.title} />;
    case "maps": {
      const name = look.map && show.names?.includes(look.map) ? look.map : show.names?.[0] ?? "";
      return <Picture source={address("/api/artifact/picture", { digest, show: show.id, name, size: 0 })} quick={address("/api/artifact/picture", { digest, show: show.id, name, size: 512 })} title={name} />;
    }
    case "environment": return <Picture source={address("/api/artifact/picture", { digest, show: show.id, exposure: look.exposure })} title="environment" />;
    case "gallery": return <Gallery digest={digest} items={show.items ?? []} />;
    case "table": return <TableOf digest={digest} show={show.id} />;
    case "curves": return <CurvesOf digest={digest} />;
    case "figures": return <FiguresOf digest={digest} />;
    case "viewer": return <iframe className="viewer" title={show.title} sandbox="allow-scripts" src={address("/api/artifact/view", { digest })} />;
    case "files": return (
      <div className="told">
        <table><tbody>{(show.files ?? []).map((file) => <tr key={file.path}><td><a href={address("/api/artifact/file", { digest, path: file.path })} download>{file.path}</a>{file.path === show.main && <span className="chip">open this one</span>}</td><td className="n">{bytes(file.bytes)}</td></tr>)}</tbody></table>
      </div>
    );
    default: return <Facts facts={show.facts ?? {}} />;
  }
}

function Facts({ facts }: { facts: { [name: string]: Json } }) {
  return <div className="told"><table><tbody>{Object.entries(facts).map(([name, value]) => <tr key={name}><td>{name.replace(/_/g, " ")}</td><td>{figure(value, 5)}</td></tr>)}</tbody></table></div>;
}
