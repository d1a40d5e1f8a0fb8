// Returns after a page has drawn what it was asked for, however slow the machine is.

export const drawn = (page) =>
  page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
