// What scrolls sideways can be reached and scrolled by the keyboard. The theme wraps tables late, so each wrapper
// is looked at as it comes.
const reach = () => document.querySelectorAll(".md-typeset__scrollwrap:not([tabindex])")
  .forEach((each) => each.setAttribute("tabindex", "0"))
new MutationObserver(reach).observe(document.documentElement, {childList: true, subtree: true})
reach()
