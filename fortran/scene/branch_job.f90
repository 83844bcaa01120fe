!> The &branch group of a scene with a mount or a polynomial system: a branch of periodic
!! solutions in the frequency, the load or a parameter of the mount.
module viscovib_branch_job
  use viscovib_checks, only: check_positive
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_crossings, only: crossing_type, find_crossings
  use viscovib_curve_branch, only: curve_branch_type, curve_options, curve_outcomes
  use viscovib_curve_groups, only: add_stability, note_crossings, read_curve, read_yes, &
    stability_note
  use viscovib_family_curve, only: judge_systems, nearly_nothing, new_family_curve, &
    new_plain_curve, system_builder
  use viscovib_group_reader, only: group_reader
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_stability, only: judge_type, new_judge, stability_type
  use viscovib_mount, only: mount_type
  use viscovib_mount_builder, only: change_mount, mount_numbers, new_mount_builder
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: oscillator_curve_type, vary_frequency, vary_load
  use viscovib_outcomes, only: outcome_converged
  use viscovib_response, only: response_options
  use viscovib_response_branch, only: follow_response, highest_chosen
  use viscovib_response_plan, only: method_newton, response_plan_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_table, only: listed, listed_units, table_type
  implicit none
  private

  public :: branch_job, read_branch, begin_mount, plan_branch, run_branch, write_branch

  type :: branch_job
    !> What varies: 'nu', 'load_factor' or one of `mount_numbers`, whose place is `number`.
    character(len=:), allocatable :: varies
    integer :: number = 0
    !> The frequency, that at the beginning if it varies (rad/s).
    real(wp) :: nu = 0.0_wp
    type(response_options) :: options
    type(curve_options) :: curve
    logical :: stability = .true.
  end type branch_job

contains

  subroutine read_branch(reader, job, is_mount)
    type(group_reader), intent(inout) :: reader
    type(branch_job), intent(out) :: job
    !> Else of a system, which has no parameters by name.
    logical, intent(in) :: is_mount
    character(len=*), parameter :: names(9) = [character(len=13) :: 'nu', 'load_factor', &
                                               mount_numbers]
    type(status_type) :: status
    character(len=:), allocatable :: word, before
    integer :: choice

    word = reader%read_text('vary', 'nu', names(:merge(9, 2, is_mount)), choice)
    if (reader%status%failed()) return
    job%varies = trim(names(choice))
    job%number = max(choice - 2, 0)
    before = merge('nu_', '   ', choice == 1)
    job%curve%start = reader%read_real(trim(before)//'from')
    job%curve%finish = reader%read_real(trim(before)//'to')
    job%nu = job%curve%start
    if (choice > 1) job%nu = reader%read_real('nu')
    job%options%choose_harmonics = .true.
    call reader%read_count('harmonics', job%options%harmonics, 'auto', &
                           job%options%choose_harmonics)
    job%options%keep_idle = .true.
    call read_curve(reader, job%curve)
    job%options%tolerance = job%curve%tolerance
    job%stability = read_yes(reader, 'stability')
    if (reader%status%failed()) return
    if (choice > 1) then
      call check_positive('nu', job%nu, status)
      call reader%place(status)
    else
      call check_positive('nu_from', job%curve%start, status)
      call reader%place(status)
      call check_positive('nu_to', job%curve%finish, status)
      call reader%place(status)
    end if
    if (.not. abs(job%curve%finish - job%curve%start) > 0.0_wp) then
      word = trim(before)//'to'
      call reader%complain(word, word//' = '//show(job%curve%finish)//': must differ from ' &
                           //trim(before)//'from')
    end if
  end subroutine read_branch

  !> The mount at the beginning of a branch along one of its parameters, which must make
  !! one at both ends.
  subroutine begin_mount(reader, job, mount)
    type(group_reader), intent(inout) :: reader
    type(branch_job), intent(in) :: job
    type(mount_type), intent(inout) :: mount
    type(status_type) :: status

    if (reader%status%failed() .or. job%number == 0) return
    call change_mount(mount, job%number, job%curve%finish, status)
    if (status%failed()) then
      ! Nothing is left of the mount.
      call reader%complain('to', status%message)
      return
    end if
    call change_mount(mount, job%number, job%curve%start, status)
    if (status%failed()) call reader%complain('from', status%message)
    if (abs(job%curve%start) > 0.0_wp .or. reader%status%failed()) return
    ! With the terms that other values have.
    call change_mount(mount, job%number, nearly_nothing, status)
  end subroutine begin_mount

  !> What will be computed; the rest of the plan is that of a single response.
  function plan_branch(varies, from, to, n_orders, stability) result(text)
    !> 'nu', 'load factor' or a parameter.
    character(len=*), intent(in) :: varies
    real(wp), intent(in) :: from, to
    !> 0: chosen at each point.
    integer, intent(in) :: n_orders
    logical, intent(in) :: stability
    character(len=:), allocatable :: text
    text = show(n_orders)//' harmonics a coordinate'
    if (n_orders == 0) text = 'harmonics up to '//show(highest_chosen) &
                              //' as the tolerance needs them at each point'
    text = 'computes: the branch from '//varies//' = '//show(from)//' to '//show(to)//', ' &
           //text//new_line('a') &
           //trim(merge('computes: stability of each point, and where it changes', &
                        'skips: stability (not wanted)                          ', stability)) &
           //new_line('a')
  end function plan_branch

  !> Follow the branch as planned.
  subroutine run_branch(job, plan, system, load, branch, orders, highest, stability, crossings, &
                        status)
    type(branch_job), intent(in) :: job
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in), target :: system
    type(load_type), intent(in), target :: load
    type(curve_branch_type), intent(out) :: branch
    !> Orders kept at any point, and the highest at each.
    integer, allocatable, intent(out) :: orders(:), highest(:)
    !> Left without arrays where it is not wanted.
    type(stability_type), intent(out) :: stability
    type(crossing_type), allocatable, intent(out) :: crossings(:)
    type(status_type), intent(out) :: status
    class(oscillator_curve_type), allocatable :: curve
    class(system_builder), allocatable :: builder
    type(judge_type) :: judge
    type(harmonic_set_type) :: set
    real(wp), allocatable :: motions(:, :, :)
    character(len=:), allocatable :: word
    integer :: outcome, shape_x(2)

    if (plan%method /= method_newton) then
      call fail(status, status_input_error, 'branch', 'nothing is nonlinear, the response is a ' &
                //'single curve: ask for &response')
      return
    end if
    select type (system)
    type is (mount_type)
      if (job%number > 0) then
        call new_mount_builder(builder, system, job%number)
        call new_family_curve(curve, builder, job%curve%start, &
                              maxval(abs([job%curve%start, job%curve%finish])), load, plan%set, &
                              job%nu, status)
        if (status%failed()) return
      end if
    end select
    if (.not. allocated(curve)) call new_plain_curve(curve, system, load, plan%set, &
                                                     merge(vary_frequency, vary_load, &
                                                           job%varies == 'nu'), job%nu)
    if (curve%vary == vary_load .and. job%number == 0) curve%balance%load_factor = job%curve%start
    call follow_response(curve, plan, job%curve, branch, set, outcome)
    if (outcome /= outcome_converged) then
      word = 'from'
      if (job%varies == 'nu') word = 'nu_from'
      call fail(status, status_input_error, word, word//' = '//show(job%curve%start) &
                //': no solution was found there, begin elsewhere')
      return
    end if
    orders = set%orders
    shape_x = [2*size(orders), system%n_dof()]
    highest = orders(branch%kept(:branch%n_points)/(2*system%n_dof()))
    allocate (crossings(0))
    if (job%stability) then
      associate (n => branch%n_points)
        motions = reshape(branch%x(:, :n), [shape_x, n])
        call new_judge(judge, system, set)
        if (job%number > 0) then
          call judge_systems(judge, curve, job%nu, branch%parameter(:n), motions, stability)
        else
          call judge%judge(system, merge(branch%parameter(:n), job%nu, job%varies == 'nu'), &
                           motions, stability)
        end if
        call find_crossings(judge, curve, job%nu, branch%parameter(:n), branch%x(:, :n), &
                            stability, branch%folds, branch%branch_points, crossings)
      end associate
    end if
    call add_base_motion()

  contains

    !> From coordinates relative to the base to absolute ones.
    subroutine add_base_motion()
      real(wp), allocatable :: factor(:)
      complex(wp), allocatable :: moved(:)
      integer :: i, j, d, k
      allocate (factor(branch%n_points), source=1.0_wp)
      if (job%varies == 'load_factor') factor = branch%parameter(:branch%n_points)
      do j = 1, size(load%orders)
        do i = 1, size(orders)
          if (orders(i) /= load%orders(j)) cycle
          do d = 1, system%n_dof()
            k = 2*(i + size(orders)*(d - 1))
            ! On their own, so that sums are rounded as elsewhere.
            moved = factor*(system%base_direction(d)*load%base(j))
            branch%x(k - 1, :branch%n_points) = branch%x(k - 1, :branch%n_points) + real(moved)
            branch%x(k, :branch%n_points) = branch%x(k, :branch%n_points) + aimag(moved)
          end do
        end do
      end do
    end subroutine add_base_motion

  end subroutine run_branch

  !> Write the table NAME in a folder, which is made if need be; the table is there
  !! whole or not at all.
  subroutine write_branch(folder, name, varies, orders, highest, branch, stability, crossings, &
                          coordinates, units, header, status)
    !> What varies, the first column.
    character(len=*), intent(in) :: folder, name, varies
    integer, intent(in) :: orders(:)
    integer, intent(in), target :: highest(:)
    type(curve_branch_type), intent(in), target :: branch
    type(stability_type), intent(in) :: stability
    type(crossing_type), intent(in) :: crossings(:)
    !> Names and units, one a coordinate.
    character(len=*), intent(in) :: coordinates(:), units(:)
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(table_type) :: table
    character(len=:), allocatable :: note, order
    integer :: d, i, k, n

    if (counting) call count_up(counted_columns, size(coordinates))
    n = branch%n_points
    call table%note('branch '//trim(curve_outcomes(branch%outcome))//'; folds at '//varies//' =' &
                    //listed(branch%folds%p(:branch%folds%n)))
    call note_crossings(table, crossings, varies)
    call table%add_reals(varies, branch%parameter(:n))
    note = 'nu: circular frequency of the load (rad/s); u = Im sum_k X_k exp(i k nu t)'
    if (allocated(stability%stable)) then
      note = note//stability_note
      call add_stability(table, stability%n_growing(:n), stability%multipliers(1, :n))
    end if
    call table%note(note//'; highest: order kept; truncation: estimated relative error of ' &
                    //'leaving out higher orders; error: of the last correction and rounding; ' &
                    //listed_units(coordinates, units))
    call table%add_integers('highest', highest)
    call table%add_reals('truncation', branch%truncation(:n))
    call table%add_reals('error', branch%error(:n))
    i = 0
    do d = 1, size(coordinates)
      do k = 1, size(orders)
        order = trim(coordinates(d))//'_'//show(orders(k))
        call table%add_reals(order//'_re', branch%x(i + 1, :n))
        call table%add_reals(order//'_im', branch%x(i + 2, :n))
        i = i + 2
      end do
    end do
    call table%write(folder, name, header, status)
  end subroutine write_branch

end module viscovib_branch_job
