"""From graph files to nodes and wires: YAML, parameters, `extends`, sub-graphs, repeat blocks, components, wires."""
