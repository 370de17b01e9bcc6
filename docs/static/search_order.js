/* Order of search results: guides and reference before changes, records and developers' pages.

   Sphinx puts this in place of its own Scorer; all but `score` is as there. No title or term adds
   as much as 100. */
var Scorer = {
  score: ([page, , , , score]) => (page.startsWith("docs/") ? score : score - 100),
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
