"""The live page of `exmesh studio`: a graph and its runs, seen, steered and rewired in a browser."""
