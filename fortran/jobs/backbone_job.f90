!> Free motions of a system without losses, continued from a linear mode; for a pendulum also
!! bifurcating families.
module viscovib_backbone_job
  use viscovib_backbone, only: follow_backbone
  use viscovib_backbone_plan, only: backbone_plan_type, new_backbone_plan
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, curve_outcomes
  use viscovib_column_notes, only: backbone_errors_note, backbone_note, stability_note
  use viscovib_curve_columns, only: add_stability, note_folds
  use viscovib_free_family, only: check_begun, follow_family, free_circle, free_family_type, &
    free_options
  use viscovib_free_orders, only: first_chosen
  use viscovib_free_pendulum, only: begin_free, free_text
  use viscovib_free_structure, only: free_structure
  use viscovib_job, only: job_report, job_type, plan_line, plan_unwanted, table_sink
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_table, only: listed, listed_units, table_type
  implicit none
  private

  public :: backbone_job

  character(len=*), parameter, public :: backbone_parameters(2) = &
    [character(len=9) :: 'amplitude', 'energy']

  type, extends(job_type) :: backbone_job
    !> The linear mode, counted from 0.
    integer :: mode = 0
    !> Index in `backbone_parameters`, and the coordinate whose amplitude is used.
    integer :: parameter = 1, dof = 0
    type(curve_options) :: options
    !> Highest order of the mode's frequency; the first one if orders are chosen.
    integer :: harmonics = first_chosen
    logical :: choose_harmonics = .true.
    !> For a pendulum: its family, and branch points at which to switch.
    type(free_options) :: free
    integer, allocatable :: switch(:)
  contains
    procedure :: plan => plan_backbone
    procedure :: run
  end type backbone_job

contains

  subroutine plan_backbone(self, subject, text, status)
    class(backbone_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    type(backbone_plan_type) :: plan
    type(subject_type), target :: free
    integer :: dof

    call set_ok(status)
    text = ''
    if (subject%is_pendulum) then
      text = plan_free(self)
    else
      call set_free(self, subject, free, dof, status)
      if (status%failed()) return
      call new_backbone_plan(plan, free%oscillator(), self%mode, dof, '', self%harmonics, &
                             self%choose_harmonics, self%options%tolerance, status)
      if (status%failed()) return
      text = free%description()//plan%text(self%options%start, self%options%finish)
    end if
    text = text//plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_backbone

  !> Text of the plan for a pendulum.
  function plan_free(job) result(text)
    type(backbone_job), intent(in) :: job
    character(len=:), allocatable :: text
    text = free_text(job%free)//plan_line(size(job%switch) > 0, &
                                          things(size(job%switch), &
                                                 'branch that bifurcates from it', &
                                                 'branches that bifurcate from it'), &
                                          'branches that bifurcate from it (no switch)')
  end function plan_free

  !> A table for the backbone and one for each bifurcating family.
  subroutine run(self, subject, sink, report, status)
    class(backbone_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(free_family_type), allocatable :: families(:)
    type(table_type) :: table
    type(subject_type), target :: free
    character(len=:), allocatable :: name
    integer :: blurred, dof, i, short

    if (subject%is_pendulum) then
      free = subject
      call run_free(self, subject%pendulum, families, status)
    else
      allocate (families(1))
      call set_free(self, subject, free, dof, status)
      if (.not. status%failed()) call run_backbone(self, free%oscillator(), dof, families(1), &
                                                   status)
    end if
    if (status%failed()) return
    do i = 1, size(families)
      name = self%kind
      if (i > 1) name = name//'_'//show(i - 1)
      call tabulate(self, free, families(i), table)
      call sink%put(name, table, status)
      if (status%failed()) return
    end do
    associate (first => families(1))
      report%complete = first%outcome == curve_completed
      report%summary = trim(curve_outcomes(first%outcome))//', ' &
                       //things(size(first%nu), 'point')//', '//things(size(first%folds), 'fold')
      if (subject%is_pendulum) report%summary = report%summary//', ' &
                                                //things(size(first%branch_p), 'branch point')
    end associate
    short = 0
    blurred = 0
    do i = 1, size(families)
      associate (tolerance => self%options%tolerance, off => families(i)%off)
        short = short + count(families(i)%truncation > max(tolerance, off))
        blurred = blurred + count(off > tolerance + self%options%atol/largest(families(i)%x))
      end associate
    end do
    report%complete = report%complete .and. short == 0
    if (short > 0) report%summary = report%summary//', '//things(short, 'point') &
                                    //' with too few harmonics'
    if (blurred > 0) report%summary = report%summary//', '//things(blurred, 'point') &
                                      //' with a rounding error above the tolerance'
    if (size(families) > 1) report%summary = report%summary//'; tables of ' &
                                             //show(size(families) - 1)//' more'
  end subroutine run

  !> The largest harmonic of each motion, of cosines (n, n_points).
  pure function largest(x)
    real(wp), intent(in) :: x(:, :)
    real(wp) :: largest(size(x, 2))
    largest = max(maxval(abs(x), 1), tiny(1.0_wp))
  end function largest

  !> The free system, and the index of the unknown with the amplitude: for a structure without
  !! damping, memory and loads, also condensed to that coordinate.
  subroutine set_free(job, subject, free, dof, status)
    type(backbone_job), intent(in) :: job
    type(subject_type), intent(in) :: subject
    type(subject_type), intent(out) :: free
    integer, intent(out) :: dof
    type(status_type), intent(out) :: status

    call set_ok(status)
    free = subject
    dof = job%dof
    if (.not. subject%is_structure) return
    dof = 1
    call free_structure(subject%model, job%dof, free%model, free%structure, status)
    free%load = free%model%load
  end subroutine set_free

  !> The family of a mount, a polynomial system or a structure.
  subroutine run_backbone(job, system, dof, family, status)
    type(backbone_job), intent(in) :: job
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: dof
    type(free_family_type), intent(out) :: family
    type(status_type), intent(out) :: status
    type(backbone_plan_type), target :: plan
    type(curve_branch_type) :: branch
    integer :: never

    call new_backbone_plan(plan, system, job%mode, dof, '', job%harmonics, &
                           job%choose_harmonics, job%options%tolerance, status)
    if (status%failed()) return
    never = 0
    call follow_backbone(plan, job%options, branch, family%orders, never)
    associate (n => branch%n_points, m => size(branch%x, 1) - 1)
      family%outcome = branch%outcome
      family%parameter = branch%parameter(:n)
      family%truncation = branch%truncation(:n)
      family%error = branch%error(:n)
      family%off = branch%off(:n)
      family%nu = branch%x(m + 1, :n)
      family%x = branch%x(:m, :n)
    end associate
    family%folds = branch%folds%p(:branch%folds%n)
    family%fold_errors = branch%folds%error(:branch%folds%n)
    allocate (family%branch_p(0))
    call check_begun(family, job%options, status)
  end subroutine run_backbone

  !> The family of a pendulum, then the bifurcating families, in the given order.
  subroutine run_free(job, pendulum, families, status)
    type(backbone_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    type(free_family_type), allocatable, intent(out) :: families(:)
    type(status_type), intent(out) :: status
    type(pendulum_type), target :: system
    type(free_options) :: options
    integer :: i, n

    allocate (families(1 + size(job%switch)))
    options = job%free
    call begin_free(pendulum, job%parameter > 1, options, system, status)
    if (status%failed()) return
    associate (first => families(1))
      call follow_family(first, system, options, options%begin, status)
      if (.not. status%failed()) call check_begun(first, options%curve, status)
      if (status%failed()) return
      ! Bifurcating families begin with its orders.
      options%highest = first%highest
      do i = 1, size(job%switch)
        n = abs(job%switch(i))
        if (n > size(first%branch_p)) then
          call fail(status, status_input_error, 'switch', 'switch = '//show(job%switch(i)) &
                    //': the backbone has '//things(size(first%branch_p), 'branch point'))
          return
        end if
        call follow_family(families(i + 1), system, options, first%branch_x(:, n), status, &
                           begin_nu=first%branch_nu(n), begin_p=first%branch_p(n), &
                           along=sign(1, job%switch(i))*first%across(:, n))
        if (status%failed()) return
      end do
    end associate
  end subroutine run_free

  !> One row per motion.
  subroutine tabulate(self, subject, family, table)
    type(backbone_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(free_family_type), intent(in), target :: family
    type(table_type), intent(out) :: table
    complex(wp), allocatable :: motions(:, :, :)
    character(len=:), allocatable :: note, varies
    integer :: i, k, n

    if (counting) call count_up(counted_columns, size(self%wanted))
    varies = trim(backbone_parameters(self%parameter))
    call note_folds(table, 'backbone', curve_outcomes(family%outcome), varies, family%folds, &
                    family%fold_errors)
    if (size(family%branch_p) > 0) then
      call table%note('branch points at '//varies//' ='//listed(family%branch_p))
    end if
    call table%add_reals('nu', family%nu)
    if (allocated(family%energy)) call table%add_reals('energy', family%energy)
    note = backbone_note
    if (allocated(family%multipliers)) then
      note = note//stability_note
      call add_stability(table, [(count_larger(family%multipliers(:, i), free_circle), &
                                  i=1, size(family%nu))], family%multipliers(1, :))
    end if
    call table%note(note//backbone_errors_note &
                    //listed_units(subject%coordinates(self%wanted), subject%units(self%wanted)))
    call table%add_reals('truncation', family%truncation)
    call table%add_reals('error', family%error)
    n = size(family%nu)
    associate (orders => family%orders)
      k = size(orders)
      motions = cmplx(0.0_wp, reshape(family%x, [k, size(family%x, 1)/k, n]), wp)
      call subject%show_motions(family%nu, spread(0.0_wp, 1, n), orders, self%wanted, .false., &
                                motions)
      do i = 1, size(self%wanted)
        do k = 1, size(orders)
          call table%hold_reals(trim(subject%coordinates(self%wanted(i)))//'_'//show(orders(k)), &
                                aimag(motions(k, i, :)))
        end do
      end do
    end associate
  end subroutine tabulate

end module viscovib_backbone_job
