// Link each figure to its image file, so that a click shows the figure in its full size.
document.addEventListener("DOMContentLoaded", () => {
  for (const image of document.querySelectorAll("article img")) {
    if (!image.closest("a")) {
      const link = document.createElement("a");
      link.href = image.src;
      link.className = "enlarge";
      link.title = "Show the figure in its full size";
      image.replaceWith(link);
      link.append(image);
    }
  }
});
