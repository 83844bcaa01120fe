!> A branch of periodic solutions of a mount or a polynomial system, in the frequency, the load
!! or a parameter of the mount.
module viscovib_branch_job
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_crossings, only: crossing_type, find_crossings
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, curve_outcomes
  use viscovib_column_notes, only: branch_errors_note, branch_note, stability_note
  use viscovib_curve_columns, only: add_stability, note_crossings, note_folds
  use viscovib_extra_columns, only: extra_columns
  use viscovib_family_curve, only: check_systems, new_family_curve, new_plain_curve, system_builder
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_job, only: job_report, job_type, plan_line, plan_unwanted, table_sink
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_stability, only: stability_checker, new_stability_checker, stability_type
  use viscovib_mount, only: mount_type
  use viscovib_mount_builder, only: new_mount_builder
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: oscillator_curve_type, vary_frequency, vary_load
  use viscovib_order_rules, only: most_along
  use viscovib_outcomes, only: outcome_converged
  use viscovib_response, only: response_options
  use viscovib_response_branch, only: follow_response
  use viscovib_response_plan, only: method_newton, new_response_plan, response_plan_type
  use viscovib_status, only: fail, show, status_input_error, status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_table, only: listed_units, table_type
  use viscovib_truncated_stability, only: doubt_curve
  implicit none
  private

  public :: branch_job, plan_along

  type, extends(job_type) :: branch_job
    !> The varied quantity: 'nu', 'load_factor' or one of `mount_numbers` with index `number`; or,
    !! with `number` 1, the number of `builder`.
    character(len=:), allocatable :: varies
    integer :: number = 0
    !> For a body with a varied number.
    class(system_builder), allocatable :: builder
    !> The frequency, or its first value if it varies (rad/s).
    real(wp) :: nu = 0.0_wp
    type(response_options) :: options
    type(curve_options) :: curve
    logical :: stability = .true.
    !> Additional columns, for a branch over the frequency or the load.
    type(extra_columns) :: extra
  contains
    procedure :: plan => plan_branch
    procedure :: run
    procedure :: may_condense
    procedure :: response_plan
  end type branch_job

contains

  !> False if a number of the system varies, or columns need all coordinates.
  subroutine may_condense(self, may, stability)
    class(branch_job), intent(in) :: self
    logical, intent(out) :: may, stability
    may = self%number == 0 .and. .not. (self%extra%sampling .or. self%extra%dissipation)
    stability = self%stability
  end subroutine may_condense

  !> Plan of each point, as for a single response.
  subroutine response_plan(self, subject, plan, status)
    class(branch_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    type(response_plan_type), intent(out) :: plan
    type(status_type), intent(out) :: status
    type(response_options) :: options
    options = self%options
    options%on_branch = .true.
    call new_response_plan(plan, subject%oscillator(), subject%load, [self%nu], method_newton, &
                           options, status)
    if (self%varies == 'nu' .and. .not. status%failed()) then
      call subject%load%check_between(self%curve%start, self%curve%finish, status)
    end if
  end subroutine response_plan

  subroutine plan_branch(self, subject, text, status)
    class(branch_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    type(response_plan_type) :: plan
    character(len=:), allocatable :: varies

    text = ''
    call self%response_plan(subject, plan, status)
    if (status%failed()) return
    call plan%describe(subject%oscillator(), subject%load, 1)
    varies = self%varies
    if (varies == 'load_factor') varies = 'load factor'
    text = subject%description()//plan_along(varies, self%curve%start, self%curve%finish, &
                      merge(0, size(plan%set%orders), plan%chosen), &
                      most_along(subject%oscillator(), subject%load), self%stability)//plan%rest &
           //plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_branch

  !> Text of the plan; the remainder is that of a single response.
  function plan_along(varies, from, to, n_orders, most, stability) result(text)
    !> 'nu', 'load factor' or a parameter.
    character(len=*), intent(in) :: varies
    real(wp), intent(in) :: from, to
    !> Number of orders, 0: chosen at each point, up to `most`.
    integer, intent(in) :: n_orders, most
    logical, intent(in) :: stability
    character(len=:), allocatable :: text
    text = things(n_orders, 'harmonic')//' per coordinate'
    if (n_orders == 0) text = 'harmonics chosen at each point to meet the ' &
                              //'tolerance, at most '//show(most)
    text = 'computes: the branch from '//varies//' = '//show(from)//' to '//show(to)//', ' &
           //text//new_line('a') &
           //plan_line(stability, 'stability of each point, and where it changes', &
                       'stability (not requested)')
  end function plan_along

  subroutine run(self, subject, sink, report, status)
    class(branch_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(response_plan_type) :: plan
    type(curve_branch_type), target :: branch
    type(stability_type) :: stability
    type(crossing_type), allocatable :: crossings(:)
    type(table_type) :: table
    type(extra_columns) :: extra
    integer, allocatable :: orders(:)
    integer, allocatable, target :: highest(:)
    integer :: blurred, i, j, n, short

    call self%response_plan(subject, plan, status)
    if (status%failed()) return
    call follow_branch(self, plan, subject%oscillator(), subject%load, branch, orders, highest, &
                       stability, crossings, status)
    if (status%failed()) return
    extra = self%extra
    call find_extra()
    if (subject%is_structure) then
      call show_structure()
    else if (size(self%wanted) < size(subject%coordinates)) then
      n = 2*size(orders)
      branch%x = branch%x([((n*(self%wanted(j) - 1) + i, i=1, n), j=1, size(self%wanted))], :)
    end if
    call tabulate(self%varies, orders, highest, branch, stability, crossings, &
                  subject%coordinates(self%wanted), subject%units(self%wanted), extra, table)
    call sink%put(self%kind, table, status)
    associate (off => branch%off(:branch%n_points))
      short = count(branch%missed(:branch%n_points) > max(branch%allowed, off))
      blurred = count(off > branch%allowed)
    end associate
    report%complete = branch%outcome == curve_completed .and. short == 0
    report%summary = trim(curve_outcomes(branch%outcome))//', ' &
                     //things(branch%n_points, 'point')//', '//things(branch%folds%n, 'fold')
    if (short > 0) report%summary = report%summary//', '//things(short, 'point') &
                                    //' with too few harmonics'
    if (blurred > 0) report%summary = report%summary//', '//things(blurred, 'point') &
                                      //' with a rounding error above the tolerance'

  contains

    !> The computed motions, their frequencies and the factors of their loads.
    subroutine take_motions(nu, factor, motions)
      real(wp), allocatable, intent(out) :: nu(:), factor(:)
      complex(wp), allocatable, intent(out) :: motions(:, :, :)

      n = branch%n_points
      motions = reshape(cmplx(branch%x(1::2, :n), branch%x(2::2, :n), wp), &
                        [size(orders), size(branch%x, 1)/(2*size(orders)), n])
      nu = spread(self%nu, 1, n)
      factor = spread(1.0_wp, 1, n)
      if (self%varies == 'nu') nu = branch%parameter(:n)
      if (self%varies == 'load_factor') factor = branch%parameter(:n)
    end subroutine take_motions

    subroutine find_extra()
      complex(wp), allocatable :: motions(:, :, :)
      real(wp), allocatable :: nu(:), factor(:)
      if (.not. (extra%sampling .or. extra%dissipation)) return
      call take_motions(nu, factor, motions)
      call extra%find(subject, orders, nu, factor, highest, .false., .not. subject%is_structure, &
                      motions)
    end subroutine find_extra

    !> Convert deflections to the requested coordinates.
    subroutine show_structure()
      complex(wp), allocatable :: motions(:, :, :)
      real(wp), allocatable :: nu(:), factor(:)

      call take_motions(nu, factor, motions)
      call subject%show_motions(nu, factor, orders, self%wanted, .false., motions)
      deallocate (branch%x)
      allocate (branch%x(2*size(orders)*size(self%wanted), n))
      branch%x(1::2, :) = reshape(real(motions), [size(orders)*size(self%wanted), n])
      branch%x(2::2, :) = reshape(aimag(motions), [size(orders)*size(self%wanted), n])
    end subroutine show_structure

  end subroutine run

  !> Follow the branch as planned.
  subroutine follow_branch(job, plan, system, load, branch, orders, highest, stability, crossings, &
                        status)
    type(branch_job), intent(in) :: job
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in), target :: system
    type(load_type), intent(in), target :: load
    type(curve_branch_type), intent(out) :: branch
    !> Orders kept at any point, and the highest at each.
    integer, allocatable, intent(out) :: orders(:), highest(:)
    !> Not allocated if not requested.
    type(stability_type), intent(out) :: stability
    type(crossing_type), allocatable, intent(out) :: crossings(:)
    type(status_type), intent(out) :: status
    class(oscillator_curve_type), allocatable :: curve
    class(system_builder), allocatable :: builder
    type(stability_checker) :: checker
    type(harmonic_set_type) :: set
    real(wp), allocatable :: motions(:, :, :)
    character(len=:), allocatable :: word
    integer :: outcome, shape_x(2)

    select type (system)
    type is (mount_type)
      if (job%number > 0) call new_mount_builder(builder, system, job%number)
    end select
    if (allocated(job%builder)) allocate (builder, source=job%builder)
    if (allocated(builder)) then
      call new_family_curve(curve, builder, job%curve%start, &
                            maxval(abs([job%curve%start, job%curve%finish])), load, plan%set, &
                            job%nu, status)
      if (status%failed()) return
    end if
    if (.not. allocated(curve)) call new_plain_curve(curve, system, load, plan%set, &
                                                     merge(vary_frequency, vary_load, &
                                                           job%varies == 'nu'), job%nu)
    if (curve%vary == vary_load .and. job%number == 0) curve%balance%load_factor = job%curve%start
    call follow_response(curve, plan, job%curve, branch, set, outcome)
    if (outcome /= outcome_converged) then
      word = 'from'
      if (job%varies == 'nu') word = 'nu_from'
      call fail(status, status_input_error, word, word//' = '//show(job%curve%start) &
                //': no solution was found there: start at another value')
      return
    end if
    orders = set%orders
    shape_x = [2*size(orders), system%n_dof()]
    highest = orders(branch%kept(:branch%n_points)/(2*system%n_dof()))
    allocate (crossings(0))
    if (job%stability) then
      associate (n => branch%n_points)
        motions = reshape(branch%x(:, :n), [shape_x, n])
        call new_stability_checker(checker, system, set)
        if (job%number > 0) then
          call check_systems(checker, curve, job%nu, branch%parameter(:n), motions, stability)
        else
          call checker%check(system, merge(branch%parameter(:n), job%nu, job%varies == 'nu'), &
                           motions, stability)
        end if
        call find_crossings(checker, curve, job%nu, branch%parameter(:n), branch%x(:, :n), &
                            stability, branch%folds, branch%branch_points, crossings)
        ! Changes of stability were located with the multipliers of the computed motions.
        call doubt_curve(checker, curve, job%nu, branch%parameter(:n), motions, &
                         branch%missed(:n), branch%allowed(:n), stability)
      end associate
    end if
    ! For a structure the coordinates include the base motion, not the deflections.
    if (.not. system%condensed) call add_base_motion()

  contains

    !> Convert coordinates relative to the base to absolute ones.
    subroutine add_base_motion()
      real(wp), allocatable :: factor(:)
      complex(wp), allocatable :: moved(:)
      complex(wp) :: y(system%n_dof())
      integer :: i, j, d, k
      allocate (factor(branch%n_points), source=1.0_wp)
      if (job%varies == 'load_factor') factor = branch%parameter(:branch%n_points)
      do j = 1, size(load%orders)
        do i = 1, size(orders)
          if (orders(i) /= load%orders(j)) cycle
          y = load%shift(system, j)
          do d = 1, system%n_dof()
            k = 2*(i + size(orders)*(d - 1))
            ! Computed separately, so that sums are rounded as elsewhere.
            moved = factor*y(d)
            branch%x(k - 1, :branch%n_points) = branch%x(k - 1, :branch%n_points) + real(moved)
            branch%x(k, :branch%n_points) = branch%x(k, :branch%n_points) + aimag(moved)
          end do
        end do
      end do
    end subroutine add_base_motion

  end subroutine follow_branch

  !> One row per point.
  subroutine tabulate(varies, orders, highest, branch, stability, crossings, names, units, extra, &
                      table)
    !> The varied quantity, the first column.
    character(len=*), intent(in) :: varies
    integer, intent(in) :: orders(:)
    integer, intent(in), target :: highest(:)
    type(curve_branch_type), intent(in), target :: branch
    type(stability_type), intent(in) :: stability
    type(crossing_type), intent(in) :: crossings(:)
    !> Of the coordinates.
    character(len=*), intent(in) :: names(:), units(:)
    type(extra_columns), intent(in) :: extra
    type(table_type), intent(out) :: table
    character(len=:), allocatable :: note, order
    integer :: d, i, k, n

    if (counting) call count_up(counted_columns, size(names))
    n = branch%n_points
    call note_folds(table, 'branch', curve_outcomes(branch%outcome), varies, &
                    branch%folds%p(:branch%folds%n), branch%folds%error(:branch%folds%n))
    call note_crossings(table, crossings, varies)
    call table%add_reals(varies, branch%parameter(:n))
    note = branch_note
    if (allocated(stability%stable)) then
      note = note//stability_note
      call add_stability(table, stability%n_growing(:n), stability%multipliers(1, :n))
    end if
    call table%note(note//branch_errors_note//listed_units(names, units))
    call table%add_integers('highest', highest)
    call table%add_reals('truncation', branch%truncation(:n))
    call table%add_reals('error', branch%error(:n))
    call extra%add(table)
    i = 0
    do d = 1, size(names)
      do k = 1, size(orders)
        order = trim(names(d))//'_'//show(orders(k))
        call table%add_reals(order//'_re', branch%x(i + 1, :n))
        call table%add_reals(order//'_im', branch%x(i + 2, :n))
        i = i + 2
      end do
    end do
  end subroutine tabulate

end module viscovib_branch_job
