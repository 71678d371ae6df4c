"""report.html: one page that shows a scene's result, for people; nothing in it comes from the network.

    text = build.page(parts.Parts(scene="office", photograph=..., materials=...))

A section appears only when its data exist. Each has a function here that turns records into numbers and pictures, and a
template under templates/ that holds its HTML. Jinja2 escapes every text that a template shows.
"""
