"""The `exmesh` command."""


def main() -> None:
    """Entry point; everything else is imported only now."""
    from exmesh_graph.cli.app import run_app

    run_app()
