"""What graph files can say, beside plain nodes and rounds: the YAML they are made of, components, the wires' rules."""
