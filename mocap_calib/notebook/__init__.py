"""What records show of themselves in notebooks: tables in HTML, and figures of plotly."""
