// Give both axes one scale: [[low, high], [low, high]] become parts of the plot's sides.
window.hamsymEqualScales = (chart, options) => {
  const grid = options.grid;
  const sides = [chart.getWidth() - grid.left - grid.right, chart.getHeight() - grid.top - grid.bottom];
  const scale = Math.max(...options.equal.map(([low, high], k) => (1.1 * (high - low)) / sides[k]));
  if (!(scale > 0)) return;
  [options.xAxis, options.yAxis].forEach((axis, k) => {
    const middle = (options.equal[k][0] + options.equal[k][1]) / 2;
    axis.min = middle - (scale * sides[k]) / 2;
    axis.max = middle + (scale * sides[k]) / 2;
    axis.axisLabel = { hideOverlap: true, showMinLabel: false, showMaxLabel: false };
  });
};

// One message draws all charts: as properties of elements their numbers would be wrapped one by one.
window.hamsymDraw = (drawn) => {
  for (const [id, options] of Object.entries(drawn)) {
    const chart = getElement(Number(id))?.chart;
    if (!chart) {
      setTimeout(() => window.hamsymDraw({ [id]: options }), 30);
      continue;
    }
    for (const axis of [options.xAxis, options.yAxis]) {
      if (axis.type === "log") axis.axisLabel.formatter = (value) => value.toExponential(0);
    }
    if (options.equal) hamsymEqualScales(chart, options);
    chart.setOption(options, { replaceMerge: ["series"] });
  }
};
