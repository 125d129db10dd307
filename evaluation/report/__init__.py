"""Reports of the evaluation: one document of tables and pictures, as Markdown and as HTML."""
