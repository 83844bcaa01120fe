!> The &branch group of a scene: a branch of periodic solutions in the frequency.
module viscovib_branch_job
  use viscovib_checks, only: check_positive
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_crossings, only: crossing_type, find_crossings, known_folds
  use viscovib_curve_branch, only: curve_branch_type, curve_options, curve_outcomes
  use viscovib_curve_groups, only: listed, read_curve, read_yes, stability_names, &
    stability_note, stability_text, write_crossings
  use viscovib_files, only: make_folder
  use viscovib_group_reader, only: group_reader
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_stability, only: judge_type, new_judge, stability_type
  use viscovib_number_text, only: exact
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: new_oscillator_curve, oscillator_curve_type, vary_frequency
  use viscovib_outcomes, only: outcome_converged
  use viscovib_response, only: response_options
  use viscovib_response_branch, only: follow_response, highest_chosen
  use viscovib_response_plan, only: method_newton, response_plan_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_text_file, only: text_writer
  implicit none
  private

  public :: branch_job, read_branch, plan_branch, run_branch, write_branch

  type :: branch_job
    type(response_options) :: options
    type(curve_options) :: curve
    logical :: stability = .true.
  end type branch_job

contains

  subroutine read_branch(reader, job)
    type(group_reader), intent(inout) :: reader
    type(branch_job), intent(out) :: job
    type(status_type) :: status

    job%curve%start = reader%read_real('nu_from')
    job%curve%finish = reader%read_real('nu_to')
    call reader%read_count('harmonics', job%options%harmonics, 'auto', &
                           job%options%choose_harmonics)
    job%options%keep_idle = .true.
    call read_curve(reader, job%curve)
    job%options%tolerance = job%curve%tolerance
    job%stability = read_yes(reader, 'stability')
    if (reader%status%failed()) return
    call check_positive('nu_from', job%curve%start, status)
    call reader%place(status)
    call check_positive('nu_to', job%curve%finish, status)
    call reader%place(status)
    if (.not. abs(job%curve%finish - job%curve%start) > 0.0_wp) then
      call reader%complain('nu_to', 'nu_to = '//show(job%curve%finish) &
                           //': must differ from nu_from')
    end if
  end subroutine read_branch

  !> What will be computed; the rest of the plan is that of a single response.
  function plan_branch(varies, from, to, n_orders, stability) result(text)
    !> 'nu' or 'load factor'.
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
    !> Orders kept at any point; if they are chosen, the highest at each.
    integer, allocatable, intent(out) :: orders(:), highest(:)
    !> Left without arrays where it is not wanted.
    type(stability_type), intent(out) :: stability
    type(crossing_type), allocatable, intent(out) :: crossings(:)
    type(status_type), intent(out) :: status
    type(oscillator_curve_type) :: curve
    type(judge_type) :: judge
    type(harmonic_set_type) :: set
    real(wp), allocatable :: motions(:, :, :)
    integer :: outcome, shape_x(2)

    if (plan%method /= method_newton) then
      call fail(status, status_input_error, 'branch', 'nothing is nonlinear, the response is a ' &
                //'single curve: ask for &response')
      return
    end if
    call new_oscillator_curve(curve, system, load, plan%set, vary_frequency)
    call curve%balance%set_frequency(system, load, job%curve%start)
    call follow_response(curve, plan, job%curve, branch, set, outcome)
    if (outcome /= outcome_converged) then
      call fail(status, status_input_error, 'nu_from', 'nu_from = '//show(job%curve%start) &
                //': no solution was found there, begin elsewhere')
      return
    end if
    orders = set%orders
    shape_x = [2*size(orders), system%n_dof()]
    if (plan%chosen) highest = orders(branch%kept(:branch%n_points)/(2*system%n_dof()))
    allocate (crossings(0))
    if (job%stability) then
      associate (n => branch%n_points, folds => branch%folds)
        motions = reshape(branch%x(:, :n), [shape_x, n])
        call new_judge(judge, system, set)
        call judge%judge(system, branch%parameter(:n), motions, stability)
        call find_crossings(judge, curve, job%curve%start, branch%parameter(:n), motions, &
                            stability, &
                            known_folds(folds%p, reshape(folds%x, [shape_x, folds%n])), &
                            crossings)
      end associate
    end if
    call add_base_motion()

  contains

    !> From coordinates relative to the base to absolute ones.
    subroutine add_base_motion()
      integer :: i, j, d, k
      do j = 1, size(load%orders)
        do i = 1, size(orders)
          if (orders(i) /= load%orders(j)) cycle
          do d = 1, system%n_dof()
            k = 2*(i + size(orders)*(d - 1))
            branch%x(k - 1, :branch%n_points) = branch%x(k - 1, :branch%n_points) &
                                                + system%base_direction(d)*real(load%base(j))
            branch%x(k, :branch%n_points) = branch%x(k, :branch%n_points) &
                                            + system%base_direction(d)*aimag(load%base(j))
          end do
        end do
      end do
    end subroutine add_base_motion

  end subroutine run_branch

  !> Write the table NAME in a folder, which is made if need be; the table is there
  !! whole or not at all.
  subroutine write_branch(folder, name, orders, highest, branch, stability, crossings, &
                          coordinates, units, header, status)
    character(len=*), intent(in) :: folder, name
    integer, intent(in) :: orders(:)
    !> Left out if not allocated.
    integer, allocatable, intent(in) :: highest(:)
    type(curve_branch_type), intent(in) :: branch
    type(stability_type), intent(in) :: stability
    type(crossing_type), intent(in) :: crossings(:)
    !> Names and units, one a coordinate.
    character(len=*), intent(in) :: coordinates(:), units(:)
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(text_writer) :: table
    character(len=:), allocatable :: row, order
    integer :: i, d, k

    if (counting) call count_up(counted_columns, size(coordinates))
    call make_folder(folder)
    call table%create(folder//'/'//name, status)
    if (status%failed()) return
    call table%add_comments(header)
    call table%add_line('# branch '//trim(curve_outcomes(branch%outcome))//'; folds at nu =' &
                        //listed(branch%folds%p(:branch%folds%n)))
    call write_crossings(table, crossings, 'nu')
    row = '# nu (rad/s); u = Im sum_k X_k exp(i k nu t)'
    if (allocated(stability%stable)) row = row//stability_note
    if (allocated(highest)) row = row//'; highest: order kept; truncation: estimated relative ' &
                                  //'error of leaving out higher orders'
    do d = 1, size(coordinates)
      row = row//', '//trim(coordinates(d))//' in '//trim(units(d))
    end do
    call table%add_line(row)
    row = 'nu'
    if (allocated(stability%stable)) row = row//stability_names
    if (allocated(highest)) row = row//',highest,truncation'
    do d = 1, size(coordinates)
      do k = 1, size(orders)
        order = trim(coordinates(d))//'_'//show(orders(k))
        row = row//','//order//'_re,'//order//'_im'
      end do
    end do
    call table%add_line(row)
    do i = 1, branch%n_points
      row = trim(exact(branch%parameter(i)))
      if (allocated(stability%stable)) then
        row = row//','//stability_text(stability%n_growing(i), stability%multipliers(1, i))
      end if
      if (allocated(highest)) row = row//','//show(highest(i))//',' &
                                    //trim(exact(branch%truncation(i)))
      do k = 1, size(branch%x, 1)
        row = row//','//trim(exact(branch%x(k, i)))
      end do
      call table%add_line(row)
    end do
    call table%finish(status)
  end subroutine write_branch

end module viscovib_branch_job
