"""Pictures of graphs: where everything lies, as SVG, as a page, as Mermaid text."""
