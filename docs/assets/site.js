// What scrolls sideways can be reached and scrolled by the keyboard, also before it is in view. The theme wraps tables
// late, and takes the attribute from code that it has not looked at yet.
const scrolling = ".md-typeset__scrollwrap:not([tabindex]), .md-typeset pre > code:not([tabindex])"
const reach = () => document.querySelectorAll(scrolling).forEach((each) => each.setAttribute("tabindex", "0"))
const changes = {childList: true, subtree: true, attributes: true, attributeFilter: ["tabindex"]}
new MutationObserver(reach).observe(document.documentElement, changes)
reach()
