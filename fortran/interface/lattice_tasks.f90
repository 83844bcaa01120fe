!> Tasks about the base frequencies of loads and their lattices of harmonics.
module viscovib_lattice_tasks
  use viscovib_drive_torus, only: default_bound, drive_torus_type, kept_by_symmetry, &
    largest_bound, lattice, lowest_bound, max_unknowns, max_without_matrix, sort_drives
  use viscovib_kinds, only: i8, wp
  use viscovib_task, only: task_type
  implicit none
  private

  public :: lattice_task

contains

  subroutine lattice_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('sort')
      call sort_loads(task)
    case ('bound')
      call find_bound(task)
    case ('usual_bounds')
      call find_usual_bounds(task)
    case ('orders')
      call list_orders(task)
    case ('kept')
      call find_kept(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine lattice_task

  !> Base frequencies of loads, from `frequency` and `amplitude` (3). `varies`: 1 to 3 a frequency,
  !! 4 to 6 an amplitude, 7 all frequencies together, 0 nothing; `subharmonic`, `max_denominator`.
  !! Returns `base` (n_axes), `drive_orders` (n_axes, 3), `named` (n_axes): the load with this
  !! frequency, 0: several loads; `axis` that varies, and its `multiple` that varies.
  subroutine sort_loads(task)
    type(task_type), intent(inout) :: task
    type(drive_torus_type) :: torus
    real(wp), pointer, contiguous :: frequency(:), amplitude(:)
    integer :: varies, subharmonic, max_denominator

    frequency => task%get_reals('frequency')
    amplitude => task%get_reals('amplitude')
    varies = task%get_integer('varies')
    subharmonic = task%get_integer('subharmonic')
    max_denominator = task%get_integer('max_denominator')
    call task%check_extents('frequency', shape(frequency), [3])
    call task%check_extents('amplitude', shape(amplitude), [3])
    if (task%failed()) return
    call sort_drives(torus, frequency, amplitude, varies, subharmonic, max_denominator, &
                     task%status)
    if (task%failed()) return
    call task%found%put_reals('base', torus%base, shape(torus%base))
    call task%found%put_integers('drive_orders', torus%orders, shape(torus%orders))
    call task%found%put_integers('named', torus%named, shape(torus%named))
    call task%found%put_integer('axis', int(torus%axis, i8))
    call task%found%put_integer('multiple', int(torus%multiple, i8))
  end subroutine sort_loads

  !> Largest `bound` of a lattice with `n_axes` if a `share` of its unknowns is kept, with or
  !! without a `matrix` for them.
  subroutine find_bound(task)
    type(task_type), intent(inout) :: task
    real(wp) :: share
    integer :: n_axes, most

    n_axes = task%get_integer('n_axes')
    share = task%get_real('share')
    most = merge(max_unknowns, max_without_matrix, task%get_flag('matrix'))
    if (task%failed()) return
    call task%found%put_integer('bound', int(largest_bound(n_axes, share, most), i8))
  end subroutine find_bound

  !> Highest harmonics that a branch must keep for its loads, `lowest`, and keeps by default,
  !! `usual`, from `drive_orders` (n_axes, 3).
  subroutine find_usual_bounds(task)
    type(task_type), intent(inout) :: task
    type(drive_torus_type) :: torus

    call read_torus(task, torus)
    if (task%failed()) return
    call task%found%put_integer('lowest', int(lowest_bound(torus), i8))
    call task%found%put_integer('usual', int(default_bound(torus), i8))
  end subroutine find_usual_bounds

  subroutine read_torus(task, torus)
    type(task_type), intent(inout) :: task
    type(drive_torus_type), intent(out) :: torus
    allocate (torus%orders, source=task%get_integer_matrix('drive_orders'))
    torus%n_axes = size(torus%orders, 1)
    call task%check_extents('drive_orders', shape(torus%orders), [torus%n_axes, 3])
  end subroutine read_torus

  !> Half of the harmonics of a lattice of `n_axes` up to a `bound`, 0 first: their number `n`, and,
  !! unless `count_only`, `orders` (n_axes, n).
  subroutine list_orders(task)
    type(task_type), intent(inout) :: task
    integer, allocatable :: orders(:, :)
    integer :: n_axes, bound
    logical :: count_only

    n_axes = task%get_integer('n_axes')
    bound = task%get_integer('bound')
    count_only = task%get_flag('count_only', .false.)
    if (task%failed()) return
    allocate (orders, source=lattice(n_axes, bound))
    call task%found%put_integer('n', size(orders, 2, kind=i8))
    if (.not. count_only) call task%found%put_integers('orders', orders, shape(orders))
  end subroutine list_orders

  !> `kept` (n, 3): 1 if a harmonic of a coordinate is an unknown of the solution from rest. Input:
  !! `drive_orders` (n_axes, 3), `orders` (n_axes, n), `amplitude` (3), `varies` (see `sort_loads`).
  subroutine find_kept(task)
    type(task_type), intent(inout) :: task
    type(drive_torus_type) :: torus
    real(wp), pointer, contiguous :: amplitude(:)
    integer, allocatable :: orders(:, :), kept(:, :)
    integer :: varies

    call read_torus(task, torus)
    allocate (orders, source=task%get_integer_matrix('orders'))
    amplitude => task%get_reals('amplitude')
    varies = task%get_integer('varies')
    call task%check_extents('orders', shape(orders), [torus%n_axes, size(orders, 2)])
    call task%check_extents('amplitude', shape(amplitude), [3])
    if (task%failed()) return
    allocate (kept(size(orders, 2), 3))
    kept = merge(1, 0, kept_by_symmetry(torus, orders, amplitude, varies))
    call task%found%put_integers('kept', kept, shape(kept))
  end subroutine find_kept

end module viscovib_lattice_tasks
