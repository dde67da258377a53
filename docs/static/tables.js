// Tables sort, filter and download by DataTables; a long one shows a page of its rows.
document.addEventListener("DOMContentLoaded", () => {
  for (const table of document.querySelectorAll("table.dataframe, .finder table")) {
    for (const cell of table.querySelectorAll("td")) {
      const text = cell.textContent.trim()
      // "–" stands for nothing, also among numbers.
      cell.dataset.order = cell.querySelector("data")?.value ?? text.replace(/^–$/, "")
      cell.dataset.head = table.tHead.rows[0].cells[cell.cellIndex].textContent.trim()
      if (text.length > 60) cell.classList.add("words")
    }
    const long = table.rows.length > 50
    const made = new DataTable(table, {
      order: [],
      autoWidth: false,
      paging: long,
      pageLength: 25,
      lengthMenu: [25, 100, { label: "all", value: -1 }],
      layout: {
        topStart: null, topEnd: long ? "search" : null,
        bottomStart: long ? ["pageLength", "info"] : null,
        bottomEnd: [...(long ? ["paging"] : []), { buttons: [{
          extend: "csvHtml5", text: "CSV",
          exportOptions: { orthogonal: "sort" } }] }],
      },
    })
    if (long) {
      addEventListener("beforeprint", () => made.page.len(-1).draw())
      addEventListener("afterprint", () => made.page.len(25).draw())
    }
  }
})
