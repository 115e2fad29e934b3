"""What Python is entered by: run, check, plan, sweep, diff, call, Graph; `import exmesh_graph as ex` names it."""
