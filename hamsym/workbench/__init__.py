"""What people look at and share: animations, notebooks, reports, the page in the browser."""
